"""What makes the ends of profiles: data, priors, or the bounds of other parameters."""

from dataclasses import replace

import numpy as np
import pytest
from few_values import few_values, moves, profiles_of, wider
from problems import ClosedForm, linear, plain_parameters

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import (
    Evaluator,
    ParameterQuantity,
    Problem,
    with_bounds,
    with_nuisance_priors,
    with_room_doubled,
)
from identknee.identify.profile.profile import profile, profile_parameters
from identknee.identify.profile.result import EndOrigin, Profile, ProfileVerdict, SideStatus

Z_95 = 1.959963984540054


def _first(problem: Problem) -> ParameterQuantity:
    return ParameterQuantity(parameters=problem.parameters, name=problem.parameters.names[0])


def _ridge(bound: float, weight: float) -> Problem:
    """The first parameter is seen with `weight`, and through the second where a bound stops it."""
    ridge = ClosedForm(
        name="ridge",
        parameters=plain_parameters(2, -3.0, 3.0),
        start=np.zeros(2),
        minimum=np.zeros(2),
        lowest=0.0,
        residuals_at=lambda x: np.array([5.0 * (x[0] / 2 - x[1]), weight * x[0]]),
        jacobian_at=lambda _: np.array([[2.5, -5.0], [weight, 0.0]]),
    )
    return with_bounds(ridge, {"x1.value_pct": (-3.0, bound)})


def test_an_end_that_another_bound_makes_says_so() -> None:
    """Weight 1 closes the lower end at -1.96; the bound closes the upper one, at 1.22."""
    problem = _ridge(bound=0.3, weight=1.0)
    found = profile(problem, np.zeros(2), _first(problem))
    assert found.lower == pytest.approx(-Z_95, abs=1e-3)
    assert found.upper == pytest.approx(_end_on_bound(0.3), abs=1e-3)
    assert (found.lower_origin, found.upper_origin) == ("data", "bound of x1.value_pct")
    assert found.upper_side.bound_of == "x1.value_pct"
    assert found.verdict is ProfileVerdict.BOUNDED_BY_ASSUMPTION
    assert not found.is_known


def _end_on_bound(bound: float) -> float:
    # 25 (x / 2 - bound)^2 + x^2 = 3.84.
    return float(np.roots([25 / 4 + 1.0, -25.0 * bound, 25.0 * bound**2 - Z_95**2]).max())


def test_a_bound_that_hardly_moves_an_end_does_not_make_it() -> None:
    problem = _ridge(bound=0.9, weight=1.0)
    found = profile(problem, np.zeros(2), _first(problem))
    assert found.upper_side.at_bounds == ("x1.value_pct",)
    # With more room it moves to 1.96, by less than a tenth of the interval.
    assert 0.0 < Z_95 - _end_on_bound(0.9) < 0.1 * (Z_95 + _end_on_bound(0.9))
    assert found.upper_origin == "data"
    assert found.verdict is ProfileVerdict.IDENTIFIABLE
    assert found.is_known


def test_a_bound_that_closes_the_only_end_is_no_limit_by_data() -> None:
    problem = _ridge(bound=0.3, weight=0.1)
    found = profile(problem, np.zeros(2), _first(problem))
    assert found.lower_status is SideStatus.OPEN_AT_BOUND
    assert (found.lower_origin, found.upper_origin) == ("own_bound", "bound of x1.value_pct")
    assert found.verdict is ProfileVerdict.BOUNDED_BY_ASSUMPTION


def test_ends_hang_on_bounds_where_a_profile_in_a_wider_box_moves_them() -> None:
    """Forty linear problems in boxes of random size, their optima on bounds or inside."""
    rng = np.random.default_rng(34)
    n_moved = n_kept = 0
    for _ in range(40):
        seed = int(rng.integers(1_000_000))
        problem = linear(4, 5, seed=seed)
        size = rng.uniform(0.3, 4.0, 4)
        size[0] = 40.0
        names = problem.parameters.names
        bounds = {x: (-float(s), float(s)) for x, s in zip(names, size, strict=True)}
        boxed = with_bounds(problem, bounds)
        wide = with_room_doubled(boxed, names)
        found, other = (
            profile(x, minimise(Evaluator(x), np.zeros(4)).evaluation.theta, _first(x))
            for x in (boxed, wide)
        )
        assert found.lower is not None
        assert found.upper is not None
        assert other.lower is not None
        assert other.upper is not None
        width = found.upper - found.lower
        for side, end, there in (
            (found.lower_side, found.lower, other.lower),
            (found.upper_side, found.upper, other.upper),
        ):
            share = abs(there - end) / width
            # What lies beside the limit of a tenth is decided by tolerances.
            if share > 0.11:
                assert side.made_by is EndOrigin.BOUND
                n_moved += 1
            elif share < 0.09:
                assert side.made_by is EndOrigin.DATA
                n_kept += 1
    assert min(n_moved, n_kept) > 15


def test_an_end_that_lies_farther_in_with_more_room_hangs_on_the_bound_too() -> None:
    """The second parameter is drawn to 2 and stops at 1, so that the first one is too large."""
    matrix = np.array([[1.0, 1.0], [0.0, 3.0]])
    pulled = ClosedForm(
        name="pulled",
        parameters=plain_parameters(2),
        start=np.zeros(2),
        minimum=np.array([1.0, 2.0]),
        lowest=0.0,
        residuals_at=lambda x: matrix @ (x - [1.0, 2.0]),
        jacobian_at=lambda _: matrix,
    )
    problem = with_bounds(pulled, {"x1.value_pct": (-1.0, 1.0)})
    found = profile(problem, np.array([2.0, 1.0]), _first(problem))
    assert found.upper == pytest.approx(2.0 + Z_95, abs=1e-3)
    # Up to 2 the best fit is at (1, 2), from where the upper end is at 3.07.
    assert found.upper_origin == "bound of x1.value_pct"
    assert found.verdict is ProfileVerdict.BOUNDED_BY_ASSUMPTION


def test_of_several_bounds_the_one_that_moves_the_end_most_is_named() -> None:
    """Both let the first parameter go; the second one lets it go farther."""
    matrix = np.array([[1.0, -0.2, -0.8], [0.05, 0.0, 0.0]]) * 4.0
    problem = with_bounds(
        ClosedForm(
            name="two",
            parameters=plain_parameters(3),
            start=np.zeros(3),
            minimum=np.zeros(3),
            lowest=0.0,
            residuals_at=lambda x: matrix @ x,
            jacobian_at=lambda _: matrix,
        ),
        {"x1.value_pct": (-0.5, 0.5), "x2.value_pct": (-0.5, 0.5)},
    )
    found = profile(problem, np.zeros(3), _first(problem))
    assert set(found.upper_side.at_bounds) == {"x1.value_pct", "x2.value_pct"}
    assert found.upper_side.bound_of == "x2.value_pct"


@pytest.mark.parametrize(("prior_sd", "origin"), [(0.9, "data"), (1.1, "prior")])
def test_priors_make_an_end_of_which_they_make_more_than_half(prior_sd: float, origin: str) -> None:
    """The sum of both is seen to 1: of its rise the prior makes sd^2 / (1 + sd^2)."""
    parameters = replace(
        plain_parameters(2), is_nuisance=np.array([False, True]), prior_sd=np.array([9.0, prior_sd])
    )
    data = ClosedForm(
        name="sum",
        parameters=parameters,
        start=np.zeros(2),
        minimum=np.zeros(2),
        lowest=0.0,
        residuals_at=lambda x: np.array([x[0] + x[1]]),
        jacobian_at=lambda _: np.array([[1.0, 1.0]]),
    )
    problem = with_nuisance_priors(data)
    found = profile(problem, np.zeros(2), _first(problem))
    assert found.upper == pytest.approx(Z_95 * np.hypot(1.0, prior_sd), rel=1e-3)
    assert (found.lower_origin, found.upper_origin) == (origin, origin)
    assert (found.verdict is ProfileVerdict.IDENTIFIABLE) == (origin == "data")


def test_an_end_that_could_not_be_computed_again_is_not_known() -> None:
    problem = _ridge(bound=0.3, weight=1.0)
    whole = profile(problem, np.zeros(2), _first(problem))
    short = [
        profile(problem, np.zeros(2), _first(problem), budget=n)
        for n in range(5, whole.n_simulations)
    ]
    unfinished = [
        x for x in short if x.upper_status is SideStatus.CLOSED and x.upper_origin is None
    ]
    assert unfinished
    assert {x.verdict for x in unfinished} == {ProfileVerdict.UNDETERMINED}
    assert all(x.verdict is not ProfileVerdict.IDENTIFIABLE for x in short)


def test_simulations_for_the_origins_are_counted() -> None:
    problem = _ridge(bound=0.3, weight=1.0)
    counted = _Counted(problem)
    found = profile(counted, np.zeros(2), _first(problem))
    assert found.n_simulations == counted.n
    free = profile(_ridge(bound=3.0, weight=1.0), np.zeros(2), _first(problem))
    assert free.n_simulations < found.n_simulations < free.n_simulations + 20


class _Counted:
    def __init__(self, problem: Problem) -> None:
        self.problem, self.parameters, self.n = problem, problem.parameters, 0

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        self.n += 1
        return self.problem.residuals(theta)

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        return self.problem.jacobian(theta)


def test_room_doubles_outward_and_keeps_what_cannot_be_negative() -> None:
    problem = few_values("reference", 1)
    strain, stiffness = "ACL.reference_strain_pct", "ACL.stiffness_kN"
    names = problem.parameters.names
    for name, given, expected in (
        (stiffness, (0.0, 40.0), (0.0, 80.0)),
        (stiffness, (5.0, 15.0), (2.5, 30.0)),
        (strain, (-15.0, 15.0), (-30.0, 30.0)),
        (strain, (2.0, 8.0), (-1.0, 16.0)),
        (strain, (-3.0, 0.0), (-6.0, 1.5)),
    ):
        wide = with_room_doubled(with_bounds(problem, {name: given}), names).parameters
        i = wide.index(name)
        assert (wide.lower[i], wide.upper[i]) == pytest.approx(expected)


def test_an_optimum_a_rounding_error_before_a_bound_has_a_profile() -> None:
    free = linear()
    upper = float(free.minimum[0])
    problem = with_bounds(free, {"x0.value_pct": (-10.0, np.nextafter(upper, np.inf))})
    found = profile(problem, free.minimum, _first(problem))
    assert found.upper_status is SideStatus.OPEN_AT_BOUND


@pytest.mark.parametrize(
    ("knee", "seed", "name"),
    [
        pytest.param("reference", 1, "ACL.reference_strain_pct", marks=pytest.mark.slow),
        pytest.param("reference", 3, "LCL.reference_strain_pct", marks=pytest.mark.slow),
        ("reference", 5, "ACL.stiffness_kN"),
        pytest.param("lenhart2015_stable", 1, "ACL.reference_strain_pct", marks=pytest.mark.slow),
        pytest.param("lenhart2015_stable", 3, "ACL.reference_strain_pct", marks=pytest.mark.slow),
        pytest.param("lenhart2015_stable", 5, "PCL.reference_strain_pct", marks=pytest.mark.slow),
    ],
)
def test_of_few_values_no_parameter_on_a_bound_is_identifiable(
    knee: str, seed: int, name: str
) -> None:
    """Against profiles with every bound doubled, as the row `ends_on_bounds` has many."""
    problem = few_values(knee, seed)
    (found,), (wide,) = (
        profiles_of(x, [name], budget=1000, looks_around=False) for x in (problem, wider(problem))
    )
    hangs = tuple(x.made_by is EndOrigin.BOUND for x in (found.lower_side, found.upper_side))
    assert hangs == moves(found, wide)
    assert (found.verdict is ProfileVerdict.IDENTIFIABLE) == (not any(hangs))


def test_profiles_with_room_and_data_are_all_identifiable() -> None:
    problem = linear(3, 8)
    found: tuple[Profile, ...] = profile_parameters(problem, problem.minimum)
    assert {x.upper_origin for x in found} == {x.lower_origin for x in found} == {"data"}
    assert {x.verdict for x in found} == {ProfileVerdict.IDENTIFIABLE}
