"""The best step of a model: against formulas and against another method."""

import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, minimize

from identknee.identify.region import Blocks, LocalModel, best_step

# The barriers end with a gap of 1e-10 of a gain of about 1.
GAIN = 1e-8
PENALTY = 100.0


def random_model(n_blocks: int, n: int, seed: int) -> LocalModel:
    """Sloppy blocks that hold the origin, and bounds of which some are at it."""
    generator = np.random.default_rng(seed)
    slopes = generator.normal(size=(n_blocks, n + 1, n))
    slopes *= 10.0 ** generator.uniform(-1, 1.5, n)
    offsets = generator.normal(size=(n_blocks, n + 1))
    offsets *= 0.9 / np.linalg.norm(offsets, axis=1, keepdims=True)
    gain = generator.normal(size=n)
    information = np.einsum("bki,bkj->ij", slopes, slopes)
    gain /= np.sqrt(n_blocks * gain @ np.linalg.solve(information, gain))
    at_bound = generator.uniform(size=n) < 0.3
    return LocalModel(
        gain=gain,
        blocks=Blocks(offsets=offsets, slopes=slopes),
        low=np.where(at_bound, 0.0, -generator.uniform(0.1, 2.0, n)),
        high=generator.uniform(0.1, 2.0, n),
    )


def test_an_ellipsoid_has_a_formula() -> None:
    matrix = np.array([[3.0, 1.0], [-1.0, 0.2]])
    blocks = Blocks(offsets=np.zeros((1, 2)), slopes=matrix[None])
    gain = np.array([0.1, 0.4])
    covariance = np.linalg.inv(matrix.T @ matrix)
    best = np.sqrt(gain @ covariance @ gain)
    wide = np.full(2, 50.0)
    found = best_step(LocalModel(gain=gain, blocks=blocks, low=-wide, high=wide), penalty=PENALTY)
    assert found.step == pytest.approx(covariance @ gain / best, rel=1e-5)
    assert gain @ found.step == pytest.approx(best, rel=GAIN)
    assert found.excess == pytest.approx(0.0, abs=GAIN)
    # The gain grows with the root of the limit.
    # The last barrier is centred to a tenth.
    assert found.multipliers == pytest.approx([best / 2], rel=0.1)


@pytest.mark.parametrize("seed", range(6))
def test_as_good_as_another_method(seed: int) -> None:
    model = random_model(1 + 4 * (seed % 2), 5, seed)
    blocks = model.blocks

    def values(step: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum((blocks.offsets + blocks.slopes @ step) ** 2, axis=1))

    def slopes(step: np.ndarray) -> np.ndarray:
        after = blocks.offsets + blocks.slopes @ step
        return np.asarray(2 * np.einsum("bki,bk->bi", blocks.slopes, after))

    found = best_step(model, penalty=PENALTY)
    other = minimize(
        lambda step: -model.gain @ step,
        np.zeros(5),
        jac=lambda _: -model.gain,
        bounds=list(zip(model.low, model.high, strict=True)),
        constraints=NonlinearConstraint(values, -np.inf, 1.0, jac=slopes),
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 500},
    )
    assert values(found.step).max() <= 1 + GAIN
    assert np.all((found.step >= model.low) & (found.step <= model.high))
    # SLSQP may stop early or a little outside.
    assert model.gain @ found.step >= model.gain @ other.x - 1e-5


def test_an_empty_region_costs_an_excess() -> None:
    """Two discs of radius 1, their centres 4 apart: the limit must be raised to 4."""
    blocks = Blocks(
        offsets=np.array([[2.0, 0.0], [-2.0, 0.0]]), slopes=np.array([np.eye(2), np.eye(2)])
    )
    wide = np.full(2, 10.0)
    model = LocalModel(gain=np.array([0.0, 0.1]), blocks=blocks, low=-wide, high=wide)
    found = best_step(model, penalty=PENALTY)
    # A little sideways is worth it: 0.1 y - 100 y^2 is largest at 5e-4.
    assert found.step == pytest.approx([0.0, 5e-4], abs=1e-6)
    assert found.excess == pytest.approx(3.0, abs=1e-5)
