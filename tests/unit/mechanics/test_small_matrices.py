"""Five by five, against numpy."""

import numpy as np
import pytest
from energy_evaluation import SCALE
from tolerances import CLOSED_FORM

from identknee.mechanics.energy import (
    factorise,
    residual_norm,
    scaled_norm,
    substitute,
    trust_region_step,
)
from identknee.runs.declare import Array

# A system of condition a few hundred.
SOLVED = 1e-11


def _stiffness(seed: int, lowest: float) -> Array:
    """A Hessian whose eigenvalues, rotations scaled, begin at `lowest` [N/mm]."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    values = np.r_[lowest, np.sort(rng.uniform(5.0, 400.0, 4))]
    return np.asarray((turn * values) @ turn.T * SCALE[:, None] * SCALE)


@pytest.mark.parametrize("seed", range(4))
def test_factor_and_solution(seed: int) -> None:
    H, b = _stiffness(seed, 2.0), np.random.default_rng(seed).normal(size=5) * SCALE
    L, x = np.zeros((5, 5)), np.zeros(5)
    shift = 0.7
    assert factorise(H, shift, L)
    shifted = H + shift * np.diag(SCALE**2)
    assert np.tril(L) == pytest.approx(np.linalg.cholesky(shifted), rel=SOLVED, abs=1e-9)
    substitute(L, b, x)
    assert shifted @ x == pytest.approx(b, rel=SOLVED, abs=1e-9)


def test_a_matrix_that_is_not_positive_definite_has_no_factor() -> None:
    L = np.zeros((5, 5))
    assert not factorise(_stiffness(0, -1.0), 0.0, L)
    assert not factorise(np.zeros((5, 5)), 0.0, L)
    assert factorise(_stiffness(0, -1.0), 1.01, L)
    assert not factorise(_stiffness(0, -1.0), 0.99, L)


def test_norms_weigh_rotations() -> None:
    assert scaled_norm(np.array([0.1, 0.0, 3.0, 0.0, 0.0])) == pytest.approx(5.0, rel=CLOSED_FORM)
    assert residual_norm(np.array([0.0, 160.0, 0.0, 3.0, 0.0])) == pytest.approx(5.0, rel=1e-12)


@pytest.mark.parametrize("lowest", [3.0, 0.0, -20.0])
@pytest.mark.parametrize("radius", [0.01, 0.5, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_trust_region_step_minimises_the_model_within_its_radius(
    seed: int, radius: float, lowest: float
) -> None:
    """The conditions of Sorensen: positive definite with the shift, shifted Newton, on the rim."""
    H, g = _stiffness(seed, lowest), np.random.default_rng(seed + 9).normal(size=5) * 30.0 * SCALE
    L, minus_g, step = np.zeros((5, 5)), np.zeros(5), np.zeros(5)
    shift = trust_region_step(g, H, radius, L, minus_g, step)
    shifted = H + shift * np.diag(SCALE**2)
    assert shift >= 0.0
    assert np.linalg.eigvalsh(shifted / SCALE / SCALE[:, None])[0] > 0.0
    assert (shifted @ step) / SCALE == pytest.approx(-g / SCALE, rel=1e-8, abs=1e-8)
    length = float(np.linalg.norm(step * SCALE))
    assert length <= 1.1 * radius
    assert shift == 0.0 or length >= 0.7 * radius


def test_inside_the_radius_it_is_newtons_step() -> None:
    H, g = _stiffness(1, 3.0), np.array([40.0, -40.0, 1.0, 1.0, -1.0])
    L, minus_g, step = np.zeros((5, 5)), np.zeros(5), np.zeros(5)
    assert trust_region_step(g, H, 10.0, L, minus_g, step) == 0.0
    assert step == pytest.approx(np.linalg.solve(H, -g), rel=SOLVED)
