"""Equivalent sets on regions known in closed form."""

import numpy as np
import pytest
from problems import Cliff, Linear, linear, plain_parameters, rosenbrock, sloppy_springs

from identknee.calibrate.problem import ParameterQuantity, UserQuantity
from identknee.identify.equivalents import (
    SEPARATION,
    Completeness,
    EquivalentSets,
    RegionSearches,
    equivalents,
)
from identknee.identify.region import (
    INSIDE_TOLERANCE,
    ExtremumEnd,
    Region,
    noise_region,
    power_of_best_test,
)
from identknee.runs.declare import Array
from identknee.runs.executors import process_pool, serial
from identknee.runs.store import open_work

# A search ends where a step predicts less than 1e-8 of the range: the value is that close, the
# place its square root.
VALUE = 1e-6
N_SETS = 30


def ellipsoid(low: float = -10.0, high: float = 10.0) -> tuple[Region, Array]:
    """A region ``|matrix (theta - center)|^2 <= 1`` with axes of different lengths."""
    generator = np.random.default_rng(3)
    turn, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    matrix = np.diag([0.5, 1.2, 4.0]) @ turn.T
    center = np.array([0.3, -0.2, 0.5])
    problem = Linear(
        parameters=plain_parameters(3, low, high), matrix=matrix, data=matrix @ center + 0.1
    )
    return noise_region(problem, center), matrix


def check(found: EquivalentSets, n_sets: int = N_SETS) -> None:
    """What every result must keep."""
    assert len(found.sets) == n_sets
    assert found.outcome is Completeness.COMPLETE
    assert found.distances.max() <= found.limit * (1 + INSIDE_TOLERANCE)
    assert found.farthest >= 0.9 * found.diameter
    assert found.farthest <= found.diameter * (1 + VALUE)
    assert found.closest >= SEPARATION * found.diameter * (1 - VALUE)


def test_an_ellipsoid_has_its_known_extents_and_diameter() -> None:
    region, matrix = ellipsoid()
    along = UserQuantity(
        name="sum", unit="", function=lambda x: float(x.sum()), gradient=lambda x: np.ones(3)
    )
    found = equivalents(region, quantities=[along], n_sets=N_SETS)
    check(found)
    covariance = np.linalg.inv(matrix.T @ matrix)
    wanted = [*np.sqrt(np.diag(covariance)), np.sqrt(covariance.sum())]
    for extrema, half, middle in zip(
        found.extrema, wanted, [*region.center, region.center.sum()], strict=True
    ):
        assert extrema.at_fit == pytest.approx(middle)
        assert extrema.upper.value == pytest.approx(middle + half, rel=VALUE)
        assert extrema.lower.value == pytest.approx(middle - half, rel=VALUE)
        for side in (extrema.lower, extrema.upper):
            assert side.end is ExtremumEnd.LIMIT
            assert side.distance == pytest.approx(1.0, abs=INSIDE_TOLERANCE)
            assert side.at_bounds == ()
            assert side.n_agreeing == side.n_searches
    # Distances are counted in 2 %.
    assert found.diameter == pytest.approx(2 * np.sqrt(np.linalg.eigvalsh(covariance)[-1]) / 2.0)


def test_bounds_cut_the_region_and_are_named() -> None:
    region, _ = ellipsoid(low=-0.5, high=0.9)
    found = equivalents(region, n_sets=N_SETS)
    check(found)
    sides = [(x.name, side) for x in found.extrema for side in (x.lower, x.upper)]
    assert {side.end for _, side in sides} == {ExtremumEnd.BOUND, ExtremumEnd.LIMIT}
    for name, side in sides:
        assert np.all((side.theta >= -0.5) & (side.theta <= 0.9))
        if side.end is ExtremumEnd.BOUND:
            assert name in side.at_bounds
            assert side.distance < 1.0


def test_a_curved_valley_is_followed_to_its_ends() -> None:
    """D^2 of Rosenbrock's residuals against those at the minimum is a banana."""
    problem = rosenbrock()
    region = noise_region(problem, problem.minimum)
    found = equivalents(region, n_sets=N_SETS)
    check(found)
    # With y free x alone is limited: |1 - x| <= 1. Then y - x^2 is within sqrt(1 - (1 - x)^2) / 10.
    x, y = found.extrema
    assert x.lower.value == pytest.approx(0.0, abs=VALUE)
    assert x.upper.value == pytest.approx(2.0, rel=VALUE)
    grid = np.linspace(0.0, 2.0, 400001)
    room = np.sqrt(np.maximum(1.0 - (1.0 - grid) ** 2, 0.0)) / 10.0
    assert y.upper.value == pytest.approx(float((grid**2 + room).max()), rel=VALUE)
    assert y.lower.value == pytest.approx(float((grid**2 - room).min()), rel=1e-5)


def test_a_region_without_prediction_is_outside() -> None:
    problem = linear()
    center = problem.minimum
    cut = Cliff(problem=problem, beyond=lambda x: float(x[0] - center[0]) - 0.1)
    found = equivalents(noise_region(cut, center), n_sets=N_SETS)
    check(found)
    assert found.sets[:, 0].max() <= center[0] + 0.1
    upper = found.extrema[0].upper
    assert upper.end is ExtremumEnd.CLIFF
    assert upper.value == pytest.approx(center[0] + 0.1, rel=1e-4)


def test_a_quantity_without_prediction_at_the_fit_is_named() -> None:
    problem = linear()
    nothing = UserQuantity(name="nothing", unit="", function=lambda _: np.nan)
    with pytest.raises(ValueError, match=r"nothing.*prediction"):
        equivalents(noise_region(problem, problem.minimum), quantities=[nothing], n_sets=N_SETS)


def test_blocks_limit_the_region_together() -> None:
    """A square: each parameter its own block."""
    problem = Linear(parameters=plain_parameters(2), matrix=np.eye(2), data=np.zeros(2))
    region = Region(
        problem=problem,
        center=np.zeros(2),
        blocks={"x": np.array([1.0, 0.0]), "y": np.array([0.0, 2.0])},
    )
    found = equivalents(region, n_sets=N_SETS)
    check(found)
    assert found.blocks == ("x", "y")
    assert found.extrema[0].upper.value == pytest.approx(1.0, rel=VALUE)
    assert found.extrema[1].lower.value == pytest.approx(-0.5, rel=VALUE)
    # The diagonal of 2 x 1, counted in 2 %.
    assert found.diameter == pytest.approx(np.sqrt(5.0) / 2.0, rel=VALUE)


def test_a_flat_direction_ends_at_the_bounds() -> None:
    problem = Linear(
        parameters=plain_parameters(2, -3.0, 5.0), matrix=np.array([[1.0, 0.0]]), data=np.zeros(1)
    )
    found = equivalents(noise_region(problem, np.zeros(2)), n_sets=N_SETS)
    check(found)
    flat = found.extrema[1]
    assert (flat.lower.value, flat.upper.value) == pytest.approx((-3.0, 5.0))
    assert flat.lower.end is ExtremumEnd.BOUND


def test_a_thread_of_a_region_holds_fewer_sets() -> None:
    problem = Linear(parameters=plain_parameters(2), matrix=np.diag([1.0, 1e5]), data=np.zeros(2))
    found = equivalents(noise_region(problem, np.zeros(2)), n_sets=120)
    assert found.outcome is Completeness.FEWER
    # A line holds 51 points 0.02 of its length apart, and a random choice not so many.
    assert 25 <= len(found.sets) <= 51
    assert found.closest >= SEPARATION * found.diameter * (1 - VALUE)
    assert "fewer" in found.outcome.sentence


def test_sets_of_the_springs_and_their_forces_in_few_simulations() -> None:
    problem = sloppy_springs()
    region = noise_region(problem, problem.minimum, limit=0.01)
    found = equivalents(region, n_sets=100)
    check(found, 100)
    assert found.n_simulations < 6000
    for extrema in found.extrema:
        assert extrema.lower.value < extrema.at_fit < extrema.upper.value


def test_the_same_with_any_executor_and_after_an_interruption(tmp_path: object) -> None:
    region, _ = ellipsoid()
    plain = equivalents(region, n_sets=N_SETS, seed=4)
    with process_pool(2) as executor:
        other = equivalents(region, n_sets=N_SETS, seed=4, executor=executor)
    assert np.array_equal(plain.sets, other.sets)
    path = f"{tmp_path}/work.sqlite"
    stopping = StopsAfter(region.problem, 500)
    stopped = Region(problem=stopping, center=region.center, blocks=region.blocks)
    with open_work(path, {}) as store, pytest.raises(KeyboardInterrupt):
        equivalents(stopped, n_sets=N_SETS, seed=4, store=store)
    with open_work(path, {}) as store:
        kept = len(store.keys())
        resumed = equivalents(region, n_sets=N_SETS, seed=4, store=store)
    assert kept > 1
    assert np.array_equal(plain.sets, resumed.sets)
    assert plain.n_simulations == resumed.n_simulations


class StopsAfter:
    """A problem that is interrupted after so many simulations."""

    def __init__(self, problem: object, n: int) -> None:
        self._problem = problem
        self._left = n
        self.parameters = problem.parameters  # type: ignore[attr-defined]

    def residuals(self, theta: Array) -> Array:
        self._left -= 1
        if self._left < 0:
            raise KeyboardInterrupt
        return np.asarray(self._problem.residuals(theta))  # type: ignore[attr-defined]

    def jacobian(self, theta: Array) -> Array:
        return np.asarray(self._problem.jacobian(theta))  # type: ignore[attr-defined]


def test_what_cannot_be_asked_is_said() -> None:
    region, _ = ellipsoid()
    with pytest.raises(ValueError, match="2, got 1"):
        equivalents(region, n_sets=1)
    with pytest.raises(ValueError, match=r"limit.* got 0"):
        noise_region(region.problem, region.center, limit=0.0)
    with pytest.raises(ValueError, match="no block"):
        Region(problem=region.problem, center=region.center, blocks={})
    with pytest.raises(ValueError, match=r"x.* shape 3"):
        equivalents(Region(problem=region.problem, center=region.center, blocks={"x": np.ones(2)}))
    nowhere = Cliff(problem=linear(), beyond=lambda _: 1.0)
    with pytest.raises(ValueError, match=r"prediction.*set"):
        equivalents(noise_region(nowhere, np.zeros(3)))


def test_power_of_the_best_test() -> None:
    assert power_of_best_test(0.0) == pytest.approx(0.05)
    assert power_of_best_test(1.0) == pytest.approx(0.2595, abs=1e-4)
    assert power_of_best_test(3.84) > 0.6


@pytest.mark.parametrize(("squared", "power"), [(0.0, 0.05), (4.0, 0.6388), (9.0, 0.9123)])
def test_power_grows_with_the_distance_and_not_with_its_square(
    squared: float, power: float
) -> None:
    """Of a one-sided test at 5 %: P(Z > 1.645 - D), by tables of the normal distribution."""
    assert power_of_best_test(squared) == pytest.approx(power, abs=1e-4)


def test_an_extremum_is_searched_again_from_a_point_that_lies_beyond_it() -> None:
    region, _ = ellipsoid()
    quantity = ParameterQuantity(
        parameters=region.problem.parameters, name=region.problem.parameters.names[0]
    )
    searches = RegionSearches(region, [quantity], serial, None)
    at_fit = searches.measured(searches.pool, "fit")[1]
    searches.extremes([(0, -1.0), (0, 1.0)], searches.pool, at_fit, "first")
    low, high = (searches.side(0, x).value for x in (-1.0, 1.0))
    assert searches.exceeded(np.array([[low], [high], [np.nan]])) == []
    assert searches.exceeded(np.array([[low], [high + 0.01]])) == [(0, 1.0)]
    # A search from the fit is done once.
    assert searches.side(0, 1.0).n_searches == 1
    assert searches.doubtful() == [(0, -1.0), (0, 1.0)]
    starts = np.vstack([region.center, region.center + 0.01])
    searches.extremes([(0, 1.0)], starts, np.array([at_fit[0], at_fit[0] + 0.01]), "more")
    assert searches.side(0, 1.0).n_searches == searches.side(0, 1.0).n_agreeing == 2
    assert searches.doubtful() == [(0, -1.0)]
