"""Terms fitted together and alone: the linear model in closed form, rates, and tension found."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from problems import Linear, plain_parameters
from scipy.optimize import lsq_linear
from scipy.stats import binomtest, chi2, kstest

from identknee.calibrate.agreement import Agreement, agreement
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array

N, P = 12, 3
TERMS = {"one": np.arange(N), "other": np.arange(N, 2 * N)}
MATRIX = np.random.default_rng(1).normal(size=(2 * N, P))


def _found(data: Array) -> Agreement:
    problem = Linear(parameters=plain_parameters(P, -50.0, 50.0), matrix=MATRIX, data=data)
    return agreement(
        problem, np.asarray(np.linalg.lstsq(MATRIX, data)[0], np.float64), TERMS, seed=3
    )


def _least(matrix: Array, data: Array) -> float:
    left = data - matrix @ np.linalg.lstsq(matrix, data)[0]
    return float(left @ left)


def test_without_priors_it_is_the_formula_and_chi_square() -> None:
    """P values are those of chi square with the parameters that the terms share."""
    data = np.random.default_rng(2).normal(size=2 * N)
    data[:N] += MATRIX[:N] @ np.array([1.0, -0.5, 0.2])
    found = _found(data)
    apart = sum(_least(MATRIX[x], data[x]) for x in TERMS.values())
    expected = _least(MATRIX, data) - apart
    assert found.difference == pytest.approx(expected, rel=1e-6)
    assert [x.n for x in found.terms] == [N, N]
    for x, rows in zip(found.terms, TERMS.values(), strict=True):
        assert x.alone == pytest.approx(_least(MATRIX[rows], data[rows]), rel=1e-6)
    assert found.inflation == pytest.approx(max(1.0, apart / (2 * N - 2 * P)))
    p = chi2.sf(expected / found.inflation, P)
    # Of 1,999 draws.
    assert binomtest(round(found.p_value * 2000), 2000, p).pvalue > 1e-3


@pytest.mark.slow
def test_terms_that_agree_have_uniform_p_values() -> None:
    rng = np.random.default_rng(5)
    p_values = [_found(rng.normal(size=2 * N)).p_value for _ in range(150)]
    assert kstest(p_values, "uniform").pvalue > 0.01


def test_noise_that_is_larger_everywhere_is_no_disagreement() -> None:
    data = 3.0 * np.random.default_rng(6).normal(size=2 * N)
    found = _found(data)
    assert found.inflation > 4.0
    assert found.p_value > 0.05


def test_the_term_that_stands_apart_is_named() -> None:
    rng = np.random.default_rng(7)
    matrix = np.vstack([MATRIX, rng.normal(size=(N, P))])
    terms = {**TERMS, "third": np.arange(2 * N, 3 * N)}
    data = rng.normal(size=3 * N)
    data[N : 2 * N] += 4.0 * MATRIX[N:, 0]
    problem = Linear(parameters=plain_parameters(P, -50.0, 50.0), matrix=matrix, data=data)
    theta = np.asarray(np.linalg.lstsq(matrix, data)[0], np.float64)
    found = agreement(problem, theta, terms)
    assert found.p_value < 1e-3
    assert found.worst.name == "other"


def test_a_parameter_at_its_bound_adds_a_degree_of_freedom() -> None:
    """The fit to all has one parameter less; those to single terms may still use it."""
    data = np.random.default_rng(8).normal(size=2 * N)
    data -= MATRIX[:, 0]
    problem = Linear(
        parameters=plain_parameters(P, -50.0, 50.0),
        matrix=MATRIX,
        data=data,
    )
    lower = np.array([0.0, -50.0, -50.0])
    problem = replace(problem, parameters=replace(problem.parameters, lower=lower))
    theta = lsq_linear(MATRIX, data, bounds=(lower, 50.0), method="bvls").x.astype(np.float64)
    assert theta[0] == 0.0
    found = agreement(problem, theta, TERMS, seed=3)
    p = chi2.sf(found.difference / found.inflation, P + 1)
    assert binomtest(round(found.p_value * 2000), 2000, p).pvalue > 1e-3


@dataclass(frozen=True)
class Valleys:
    """Minima of the first term near every whole number, the lowest at 2; the other is at 0."""

    parameters: Parameters = field(default_factory=lambda: plain_parameters(1, -5.0, 5.0))

    def residuals(self, theta: Array) -> Array:
        x = float(theta[0])
        return np.array([0.2 * (x - 2.0), 3.0 * np.sin(np.pi * x), 2.0 * x, x])

    def jacobian(self, theta: Array) -> Array:
        return np.array([[0.2], [3.0 * np.pi * np.cos(np.pi * float(theta[0]))], [2.0], [1.0]])


def test_a_term_alone_may_have_its_minimum_far_from_the_fit_to_all() -> None:
    terms = {"one": np.array([0, 1]), "other": np.array([2, 3])}
    here = agreement(Valleys(), np.zeros(1), terms)
    assert here.terms[0].alone > 0.1
    found = agreement(Valleys(), np.zeros(1), terms, starts=(np.array([1.9]),))
    assert found.terms[0].alone < 1e-9
    assert found.difference > here.difference + 0.1
