"""Sobol and Morris indices against closed forms, against SALib, and with failures."""

import numpy as np
import pytest
from SALib.analyze import morris as salib_morris
from SALib.analyze import sobol as salib_sobol

from identknee.identify.sensitivity import (
    Box,
    box_draws,
    morris_trajectories,
    saltelli_blocks,
)
from identknee.identify.sensitivity_estimators import (
    morris_indices,
    sample_sizes,
    sobol_indices,
)
from identknee.runs.declare import Array

# Three reported half-widths are nearly six standard errors.
HALF_WIDTHS = 3.0
SAME = 1e-10
CUBE = Box(lower=-np.pi * np.ones(3), upper=np.pi * np.ones(3))


def ishigami(x: Array) -> Array:
    return np.asarray(
        np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])
    )


def ishigami_indices() -> tuple[Array, Array]:
    """First-order and total indices (Ishigami and Homma 1990)."""
    a, b = 7.0, 0.1
    v1, v2 = 0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8
    v13 = b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    total = v1 + v2 + v13
    return np.array([v1, v2, 0.0]) / total, np.array([v1 + v13, v2, v13]) / total


def g_function(x: Array, a: Array) -> Array:
    return np.asarray(np.prod((np.abs(4 * x - 2) + a) / (1 + a), axis=-1))


def g_indices(a: Array) -> tuple[Array, Array]:
    """First-order and total indices of Sobol's g-function."""
    partial = 1 / (3 * (1 + a) ** 2)
    total = np.prod(1 + partial) - 1
    others = np.array([np.prod(1 + np.delete(partial, i)) for i in range(len(a))])
    return partial / total, partial * others / total


def test_sobol_indices_of_closed_forms() -> None:
    a = np.array([0.0, 1.0, 4.5, 9.0])
    unit = Box(lower=np.zeros(4), upper=np.ones(4))
    for box, model, (first, total) in (
        (CUBE, ishigami, ishigami_indices()),
        (unit, lambda x: g_function(x, a), g_indices(a)),
    ):
        outputs = model(saltelli_blocks(box, 1024, seed=1))[..., None]
        found = sobol_indices(outputs, np.array([0]), seed=2)
        for name, exact in (("S1", first), ("ST", total)):
            error = np.abs(found[name].final[0] - exact)
            assert np.all(error <= HALF_WIDTHS * found[name].final_half_widths[0] + SAME)
            assert found[name].final_half_widths.max() < 0.15


def test_sobol_indices_are_those_of_salib() -> None:
    points = saltelli_blocks(CUBE, 64, seed=3)
    y = ishigami(points)
    found = sobol_indices(y[..., None], np.array([0]), seed=0)
    centred = y - y[:, [0, -1]].mean()
    a, b = centred[:, 0], centred[:, -1]
    first = [float(salib_sobol.first_order(a, centred[:, 1 + i], b)) for i in range(3)]
    total = [float(salib_sobol.total_order(a, centred[:, 1 + i], b)) for i in range(3)]
    assert found["S1"].final[0] == pytest.approx(first, abs=SAME)
    assert found["ST"].final[0] == pytest.approx(total, abs=SAME)


def test_morris_effects_are_those_of_salib() -> None:
    unit = Box(lower=np.zeros(3), upper=np.ones(3))
    points = morris_trajectories(unit, 20, seed=3)
    y = ishigami(CUBE.scaled(points))
    found = morris_indices(points, y[..., None], np.array([0]), seed=0)
    problem = {"num_vars": 3, "names": list("abc"), "bounds": [[0.0, 1.0]] * 3}
    theirs = salib_morris.analyze(problem, points.reshape(-1, 3), y.ravel(), num_levels=4, seed=1)
    for name in ("mu_star", "mu", "sigma"):
        assert found[name].final[0] == pytest.approx(np.asarray(theirs[name]), abs=SAME)


def test_morris_effects_of_a_linear_function_are_its_slopes() -> None:
    box = Box(lower=np.array([1.0, -2.0]), upper=np.array([3.0, 2.0]))
    points = morris_trajectories(box, 8, seed=0)
    y = points @ np.array([[5.0, 1.0], [-0.5, 0.0]])
    unit = (points - box.lower) / (box.upper - box.lower)
    found = morris_indices(unit, y, np.array([0, 1]), seed=0)
    assert found["mu"].final == pytest.approx(np.array([[10.0, -2.0], [2.0, 0.0]]), abs=SAME)
    assert found["mu_star"].final == pytest.approx(np.array([[10.0, 2.0], [2.0, 0.0]]), abs=SAME)
    assert found["sigma"].final.max() < 1e-6
    assert found["mu_star"].final_half_widths.max() < 1e-6


def test_a_group_weighs_its_outputs_by_their_variance() -> None:
    points = saltelli_blocks(Box(lower=np.zeros(2), upper=np.ones(2)), 256, seed=5)
    y = np.stack([3.0 * points[..., 0], points[..., 1], points[..., 1]], axis=-1)
    found = sobol_indices(y, np.array([0, 0, 1]), seed=0)
    assert found["ST"].final == pytest.approx(np.array([[0.9, 0.1], [0.0, 1.0]]), abs=0.01)


def test_an_output_that_does_not_vary_depends_on_nothing() -> None:
    points = saltelli_blocks(Box(lower=np.zeros(2), upper=np.ones(2)), 16, seed=5)
    y = np.stack([points[..., 0], 7.0 + 1e-15 * points[..., 1]], axis=-1)
    found = sobol_indices(y, np.array([0, 1]), seed=0)
    assert np.all(found["S1"].final[1] == 0.0)
    assert np.all(found["ST"].final_half_widths[1] == 0.0)


def test_indices_are_shown_at_growing_numbers_and_half_widths_shrink() -> None:
    found = sobol_indices(
        ishigami(saltelli_blocks(CUBE, 2048, seed=1))[..., None], np.array([0]), seed=2
    )["ST"]
    assert found.levels.tolist() == [256, 512, 1024, 2048]
    # Eight times the samples: the root of 8, within the noise of a resampled spread.
    ratio = found.half_widths[0, 0, 0] / found.half_widths[-1, 0, 0]
    assert ratio == pytest.approx(np.sqrt(8), rel=0.3)
    shorter = sobol_indices(
        ishigami(saltelli_blocks(CUBE, 256, seed=1))[..., None], np.array([0]), seed=9
    )["ST"]
    # The first blocks of a longer design are the shorter design; only the mean taken off differs.
    assert found.values[0] == pytest.approx(shorter.final, abs=0.01)
    assert sample_sizes(5).tolist() == [5]


def with_holes(y: Array, points: Array) -> Array:
    """No prediction where the first parameter is high."""
    return np.where(points[..., 0] > 0.9, np.nan, y)


def test_failures_count_as_the_mean_and_complete_blocks_are_given_beside() -> None:
    """The completed function has closed-form indices, which the main rule must give."""
    points = saltelli_blocks(Box(lower=np.zeros(2), upper=np.ones(2)), 4096, seed=5)
    y = with_holes(points[..., 0] + points[..., 1], points)
    found = sobol_indices(y[..., None], np.array([0]), seed=0)
    # f = (x1 - 0.45) + (x2 - 0.5) for x1 < 0.9, and 0 beyond.
    v1, both = 0.9 * 0.9**2 / 12, 0.9 / 12
    v2 = 0.9**2 / 12
    total = v1 + both
    exact = np.array([v1 + both - v2, both]) / total
    error = np.abs(found["ST"].final[0] - exact)
    assert np.all(error <= HALF_WIDTHS * found["ST"].final_half_widths[0])
    # Complete blocks: as if the first parameter ended at 0.9.
    inside = np.array([0.81, 1.0]) / 1.81
    error = np.abs(found["ST"].complete[0] - inside)
    assert np.all(error <= HALF_WIDTHS * found["ST"].complete_half_widths[0])


def test_effects_next_to_a_failure_are_left_out() -> None:
    unit = Box(lower=np.zeros(3), upper=np.ones(3))
    points = morris_trajectories(unit, 64, seed=3)
    y = with_holes(points @ np.array([1.0, 2.0, 4.0]), points)
    found = morris_indices(points, y[..., None], np.array([0]), seed=0)
    assert found["mu"].final[0] == pytest.approx([1.0, 2.0, 4.0], abs=SAME)
    assert found["mu"].complete[0] == pytest.approx([1.0, 2.0, 4.0], abs=SAME)


def test_an_output_that_is_never_there_has_no_index() -> None:
    points = saltelli_blocks(Box(lower=np.zeros(2), upper=np.ones(2)), 16, seed=5)
    y = np.stack([points[..., 0], np.full(points.shape[:2], np.nan)], axis=-1)
    found = sobol_indices(y, np.array([0, 1]), seed=0)
    assert np.isnan(found["ST"].final[1]).all()
    assert np.isfinite(found["ST"].final[0]).all()
    unit = morris_trajectories(Box(lower=np.zeros(2), upper=np.ones(2)), 8, seed=5)
    y = np.full((8, 3, 1), np.nan)
    assert np.isnan(morris_indices(unit, y, np.array([0]), seed=0)["mu_star"].final).all()


def test_designs_grow_at_their_end() -> None:
    """So that more simulations can be added to those already made."""
    for design in (saltelli_blocks, morris_trajectories, box_draws):
        few, many = design(CUBE, 4, seed=1), design(CUBE, 16, seed=1)
        assert np.array_equal(few, many[:4])
        assert np.all(np.abs(many) <= np.pi)


def test_bad_designs_are_refused() -> None:
    with pytest.raises(ValueError, match=r"blocks.*1000.*1024"):
        saltelli_blocks(CUBE, 1000, seed=0)
    with pytest.raises(ValueError, match="2 trajectories, got 1"):
        morris_trajectories(CUBE, 1, seed=0)
    with pytest.raises(ValueError, match=r"parameter 2 .*1 to 1"):
        Box(lower=np.array([0.0, 1.0]), upper=np.array([1.0, 1.0]))
