"""Nuisances with priors in linear problems, where every answer has a closed form."""

from dataclasses import dataclass

import numpy as np
import pytest

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import (
    misfit_square,
    n_prior_rows,
    with_all_priors,
    with_nuisance_priors,
    without_priors,
)
from identknee.checks.fit_checks import nuisance_findings
from identknee.identify.optimum import nuisance_estimates, nuisance_groups
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array

SD = np.array([1.0, 1.0, 2.0, 0.5])


@dataclass(frozen=True)
class Linear:
    """Residuals ``design @ theta - data`` with two parameters asked for and two nuisances."""

    design: Array
    data: Array

    @property
    def parameters(self) -> Parameters:
        return Parameters(
            names=("a_pct", "b_pct", "insertion.ACL_femur_x_mm", "insertion.ACL_femur_y_mm"),
            center=np.zeros(4),
            lower=np.full(4, -1e3),
            upper=np.full(4, 1e3),
            prior_sd=SD,
            is_log=np.zeros(4, bool),
            is_nuisance=np.array([False, False, True, True]),
        )

    def residuals(self, theta: Array) -> Array:
        return self.design @ theta - self.data

    def jacobian(self, theta: Array) -> Array:
        return self.design


@pytest.fixture
def problem() -> Linear:
    generator = np.random.default_rng(1)
    return Linear(design=generator.standard_normal((12, 4)), data=generator.standard_normal(12))


def test_a_fit_beside_nuisances_is_the_fit_with_their_covariance(problem: Linear) -> None:
    """Least squares with rows of priors equals generalised least squares with V = 1 + J C J'."""
    best = fit(with_nuisance_priors(problem), np.zeros(4))
    asked, nuisances = problem.design[:, :2], problem.design[:, 2:] * SD[2:]
    weight = np.linalg.inv(np.eye(12) + nuisances @ nuisances.T)
    expected = np.linalg.solve(asked.T @ weight @ asked, asked.T @ weight @ problem.data)
    np.testing.assert_allclose(best.theta[:2], expected, atol=1e-7)


def test_priors_are_added_once(problem: Linear) -> None:
    theta = np.ones(4)
    whole = with_all_priors(with_nuisance_priors(problem))
    assert whole.residuals(theta).size == 12 + 4
    assert with_nuisance_priors(problem).residuals(theta).size == 12 + 2
    assert without_priors(with_nuisance_priors(problem)) is problem


def test_a_misfit_counts_data_and_nuisances_and_no_other_priors(problem: Linear) -> None:
    theta = np.array([1.5, -0.5, 3.0, 0.2])
    stated = with_nuisance_priors(problem)
    whole = with_all_priors(problem)
    expected = float(np.sum(stated.residuals(theta) ** 2))
    assert misfit_square(stated, theta) == pytest.approx(expected)
    assert misfit_square(whole, theta) == pytest.approx(expected)
    assert float(np.sum(whole.residuals(theta) ** 2)) > expected + 0.1
    data = float(np.sum(problem.residuals(theta) ** 2))
    assert misfit_square(problem, theta) == pytest.approx(data)
    assert [n_prior_rows(x) for x in (problem, stated, whole)] == [0, 2, 4]


def test_estimates_have_the_covariance_of_data_and_prior(problem: Linear) -> None:
    whole = with_nuisance_priors(problem)
    best = fit(whole, np.zeros(4))
    information = problem.design.T @ problem.design + np.diag(np.r_[0.0, 0.0, SD[2:] ** -2.0])
    expected = np.sqrt(np.diag(np.linalg.inv(information)))[2:]
    found = nuisance_estimates(whole, best.theta)
    np.testing.assert_allclose([x.sd for x in found], expected, rtol=1e-9)
    np.testing.assert_allclose([x.value for x in found], best.theta[2:])


@pytest.mark.slow
def test_groups_beyond_their_prior_are_as_rare_as_they_say() -> None:
    """P-values of nuisances drawn from their prior are uniform: mean 1/2, sd 1/sqrt(12 n)."""
    generator = np.random.default_rng(2)
    design = generator.standard_normal((12, 4))
    n, p_values = 400, []
    for _ in range(n):
        truth = np.r_[generator.standard_normal(2), SD[2:] * generator.standard_normal(2)]
        whole = with_nuisance_priors(
            Linear(design=design, data=design @ truth + generator.standard_normal(12))
        )
        (group,) = nuisance_groups(whole, fit(whole, np.zeros(4)).theta)
        p_values.append(group.p_value)
    assert np.mean(p_values) == pytest.approx(0.5, abs=4.0 / np.sqrt(12 * n))
    assert np.mean(np.array(p_values) < 0.1) == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / n))


def test_a_nuisance_far_out_is_a_finding_with_its_name(problem: Linear) -> None:
    far = Linear(design=problem.design, data=problem.design @ [0.0, 0.0, 12.0, 0.0])
    whole = with_nuisance_priors(far)
    (finding,) = nuisance_findings(whole, fit(whole, np.zeros(4)).theta)
    assert (finding.code, finding.where) == ("nuisance-beyond-prior", "insertion.ACL_femur")
    assert finding.values["nuisance"] == "insertion.ACL_femur_x_mm"
    assert finding.values["unit"] == "mm"
    assert abs(finding.values["moved"]) > 2.0 * finding.values["scatter"]
    whole = with_nuisance_priors(problem)
    assert nuisance_findings(whole, fit(whole, np.zeros(4)).theta) == ()
