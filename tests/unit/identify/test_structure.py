"""The rank at random points against problems whose structure is known."""

from dataclasses import replace

import numpy as np
import pytest
from problems import Cliff, ClosedForm, Linear, plain_parameters, sloppy_springs

from identknee.identify.information import Structure, check_structure
from identknee.runs.declare import Array


def _product() -> ClosedForm:
    """A first parameter times a second one, and a third: of the first two the product is known."""

    def residuals(x: Array) -> Array:
        return np.array([x[0] * x[1], 2.0 * x[0] * x[1] + x[2], x[2] ** 2])

    def jacobian(x: Array) -> Array:
        return np.array([[x[1], x[0], 0], [2 * x[1], 2 * x[0], 1], [0, 0, 2 * x[2]]])

    return ClosedForm(
        name="product",
        parameters=plain_parameters(3),
        start=np.ones(3),
        minimum=np.zeros(3),
        lowest=0.0,
        residuals_at=residuals,
        jacobian_at=jacobian,
    )


def test_springs_are_structurally_determined_and_slack_ones_are_seen() -> None:
    found = check_structure(sloppy_springs())
    assert found.verdict is Structure.FULL_RANK
    assert found.rank == 8
    assert found.undetermined == ()
    assert found.has_prediction.all()
    slack = found.ranks < 8
    assert slack.any()
    # A spring that is slack in all trials takes both its parameters along.
    dead = found.has_no_influence
    np.testing.assert_array_equal(dead[:, :4] | (found.thetas[:, :4] == 0), dead[:, 4:])
    np.testing.assert_array_equal(8 - dead.sum(axis=1) >= found.ranks, True)


def test_a_product_is_deficient_everywhere_and_names_its_factors() -> None:
    found = check_structure(_product(), n_points=10)
    assert found.ranks.tolist() == [2] * 10
    assert found.verdict is Structure.RANK_DEFICIENT
    assert found.undetermined == ("x0.value_pct", "x1.value_pct")
    assert "undetermined" in found.verdict.sentence


def test_points_without_prediction_stay() -> None:
    cliff = Cliff(problem=_product(), beyond=lambda x: float(x[0]))
    found = check_structure(cliff, n_points=32)
    beyond = found.thetas[:, 0] > 0
    assert beyond.any()
    np.testing.assert_array_equal(found.has_prediction, ~beyond)
    assert np.isnan(found.singular_values[beyond]).all()
    assert np.isfinite(found.singular_values[~beyond]).all()


def test_without_any_prediction_nothing_is_said() -> None:
    found = check_structure(Cliff(problem=_product(), beyond=lambda _: 1.0), n_points=3)
    assert found.verdict is Structure.UNKNOWN
    assert found.undetermined == ()


def test_fewer_residuals_than_parameters_are_deficient() -> None:
    problem = Linear(parameters=plain_parameters(3), matrix=np.eye(2, 3), data=np.zeros(2))
    found = check_structure(problem, n_points=4)
    assert found.rank == 2
    assert found.undetermined == ("x2.value_pct",)


def test_the_seed_repeats_the_points() -> None:
    first, again, other = (check_structure(_product(), n_points=5, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.thetas, again.thetas)
    assert not np.array_equal(first.thetas, other.thetas)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match=r"points.* 1, got 0"):
        check_structure(_product(), n_points=0)
    problem = _product()
    open_box = replace(
        problem, parameters=replace(problem.parameters, upper=np.array([np.inf, 1.0, 1.0]))
    )
    with pytest.raises(ValueError, match=r"x0\.value_pct.*bounds"):
        check_structure(open_box)
