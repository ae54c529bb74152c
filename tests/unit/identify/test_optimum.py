"""The best of several fits, and starts that are refused."""

from dataclasses import replace

import numpy as np
import pytest
from problems import ClosedForm, plain_parameters, sloppy_springs

from identknee.calibrate.fit import fit
from identknee.identify.optimum import (
    N_FINISHED,
    N_STARTS,
    best_fit,
    best_fits,
    sobol_around,
    with_fits_from,
    with_hops,
)
from identknee.runs.declare import Array
from identknee.runs.record import Outcome

LEFT, RIGHT = -2.0, 2.0


def two_valleys() -> ClosedForm:
    """Minima near -2 and 2, the right one lower."""

    def residuals(x: Array) -> Array:
        return np.array([(x[0] - LEFT) * (x[0] - RIGHT), 0.3 * (x[0] - RIGHT)])

    return ClosedForm(
        name="two valleys",
        parameters=plain_parameters(1),
        start=np.array([-2.5]),
        minimum=np.array([RIGHT]),
        lowest=0.0,
        residuals_at=residuals,
        jacobian_at=lambda x: np.array([[2.0 * x[0]], [0.3]]),
    )


def test_the_other_starts_find_the_lower_valley() -> None:
    problem = two_valleys()
    found = best_fit(problem, start=problem.start)
    assert found.theta == pytest.approx([RIGHT], abs=1e-8)


def test_one_valley_is_found_from_the_centre() -> None:
    problem = sloppy_springs()
    assert best_fit(problem).theta == pytest.approx(problem.minimum, abs=1e-5)


def test_of_brief_fits_only_the_lowest_goes_on_to_its_end() -> None:
    problem = sloppy_springs()
    lowest, *others = best_fits(problem, budget=4)
    assert lowest.theta == pytest.approx(problem.minimum, abs=1e-5)
    stopped = [x for x in others if x.outcome is Outcome.BUDGET]
    assert len(stopped) > 16 - N_FINISHED
    assert {x.n_simulations for x in stopped} == {4}


def test_hops_can_follow_later() -> None:
    problem = two_valleys()
    at_once = best_fits(problem, budget=4)
    before = best_fits(problem, budget=4, hops=False)
    assert len(before) < len(at_once)
    later = with_hops(problem, before, budget=4)
    assert [x.theta.tolist() for x in later] == [x.theta.tolist() for x in at_once]


def test_hops_reach_a_lower_valley_beside_the_lowest_end() -> None:
    """From the left minimum of two, no other start, a hop of one prior sd leads to the right."""
    problem = ClosedForm(
        name="two near valleys",
        parameters=plain_parameters(1),
        start=np.array([-0.4]),
        minimum=np.array([0.4]),
        lowest=0.0,
        residuals_at=lambda x: np.array([10.0 * (x[0] ** 2 - 0.16), 0.3 * (x[0] - 0.4)]),
        jacobian_at=lambda x: np.array([[20.0 * x[0]], [0.3]]),
    )
    first = fit(problem, problem.start)
    assert first.theta[0] < 0.0
    (alone,) = with_fits_from(problem, first, np.zeros((0, 1)))
    assert alone is first
    lowest = with_fits_from(problem, first, np.zeros((0, 1)), budget=50)[0]
    assert lowest.theta == pytest.approx([0.4], abs=1e-6)


def test_further_groups_begin_until_three_searches_have_ended_lowest() -> None:
    """A minimum near every whole number, the lowest near 10: each search ends where it began."""
    problem = ClosedForm(
        name="many valleys",
        parameters=plain_parameters(1),
        start=np.array([-10.0]),
        minimum=np.array([10.0]),
        lowest=0.01,
        residuals_at=lambda x: np.array([3.0 * np.sin(np.pi * x[0]), 0.05 * (x[0] - 12.0)]),
        jacobian_at=lambda x: np.array([[3.0 * np.pi * np.cos(np.pi * x[0])], [0.05]]),
    )
    first, points = fit(problem, problem.start), np.arange(-10.0, 11.0)[:, None]
    found = with_fits_from(problem, first, points)
    assert len(found) == 1 + len(points)
    assert found[0].theta == pytest.approx([10.0], abs=1e-2)
    points[:3] = 5.0
    found = with_fits_from(problem, first, points)
    assert len(found) == 1 + N_STARTS
    assert found[0].theta == pytest.approx([5.0], abs=1e-2)


def test_what_a_fit_holds_is_held_in_the_others() -> None:
    problem = sloppy_springs()
    start = problem.parameters.center
    first = fit(problem, start, fixed=problem.parameters.names[:1])
    points = start + 0.1 * np.random.default_rng(0).normal(size=(4, start.size))
    for other in with_fits_from(problem, first, points, budget=30):
        assert other.theta[0] == start[0]


def torn(misfit: float) -> ClosedForm:
    """A stiffness that is 1 or a fiftieth, and 1 with a residual that the fiftieth has not."""
    own, gone = plain_parameters(1, low=1e-4), np.log(0.02)
    names = replace(own, center=np.ones(1), is_log=np.ones(1, bool), prior_sd=np.array([0.3]))

    def residuals(x: Array) -> Array:
        u = np.log(x[0])
        return np.array([5.0 * u * (u - gone), misfit * (u - gone) / gone])

    def jacobian(x: Array) -> Array:
        u = np.log(x[0])
        slopes = [[5.0 * (2.0 * u - gone) / x[0]], [misfit / gone / x[0]]]
        return np.array(slopes)

    return ClosedForm(
        name="torn",
        parameters=names,
        start=np.array([1.1]),
        minimum=np.array([0.02]),
        lowest=0.0,
        residuals_at=residuals,
        jacobian_at=jacobian,
    )


def test_where_much_misfit_is_left_a_search_begins_without_a_ligament() -> None:
    problem = torn(misfit=6.0)
    first = fit(problem, problem.start)
    assert first.theta[0] > 0.5
    lowest, other = with_fits_from(problem, first, np.zeros((0, 1)))
    assert lowest.theta == pytest.approx(problem.minimum, rel=1e-6)
    assert other is first


def test_where_little_is_left_none_does() -> None:
    problem = torn(misfit=1.0)
    first = fit(problem, problem.start)
    assert with_fits_from(problem, first, np.zeros((0, 1))) == (first,)


def test_a_start_outside_the_bounds_is_refused() -> None:
    with pytest.raises(ValueError, match=r"start.*x0\.value_pct.*11"):
        best_fit(two_valleys(), start=np.array([11.0]))


def test_starts_around_a_point_stay_within_the_bounds_however_wide_the_prior() -> None:
    own = plain_parameters(2, low=0.1)
    parameters = replace(own, prior_sd=np.array([1e4, 1e4]), is_log=np.array([True, False]))
    points = sobol_around(parameters, np.array([1.0, 2.0]), 8, reach=2.0, seed=0)
    assert np.all((points >= parameters.lower) & (points <= parameters.upper))
    assert (points == parameters.lower).any(axis=0).all()
    assert (points == parameters.upper).any(axis=0).all()


def test_no_hops_follow_where_half_of_many_fits_agree() -> None:
    problem = sloppy_springs()
    fits = best_fits(problem)
    near = [x for x in fits if x.deviance < fits[0].deviance + 1e-3]
    assert 2 * len(near) > len(fits)
    assert with_hops(problem, fits, budget=50) == tuple(fits)
    assert len(with_hops(problem, fits[:8], budget=50)) > 8
