"""Names, bounds and priors of the calibrated parameters."""

import numpy as np
import pytest

from identknee.model.parameters import Parameters, ligament_parameters


@pytest.fixture
def parameters() -> Parameters:
    return ligament_parameters(["ACL", "MCL deep"], [10.0, 8.3], [8.0, 4.0])


def test_stiffnesses_come_first(parameters: Parameters) -> None:
    assert parameters.names == (
        "ACL.stiffness_kN",
        "MCL deep.stiffness_kN",
        "ACL.reference_strain_pct",
        "MCL deep.reference_strain_pct",
    )
    assert parameters.center.tolist() == [10.0, 8.3, 8.0, 4.0]
    assert parameters.n == 4


def test_box_and_prior_are_those_of_the_design(parameters: Parameters) -> None:
    assert parameters.lower.tolist() == [0.0, 0.0, -15.0, -15.0]
    assert parameters.upper.tolist() == [40.0, 40.0, 15.0, 15.0]
    assert parameters.is_log.tolist() == [True, True, False, False]
    assert parameters.prior_sd.tolist() == [0.35, 0.35, 2.0, 2.0]


def test_a_vector_is_the_subjects_own_but_for_the_named(parameters: Parameters) -> None:
    theta = parameters.vector({"MCL deep.stiffness_kN": 9.0})
    assert theta.tolist() == [10.0, 9.0, 8.0, 4.0]
    assert parameters.center.tolist() == [10.0, 8.3, 8.0, 4.0]
    assert parameters.index("ACL.reference_strain_pct") == 2


def test_some_can_be_chosen_in_any_order(parameters: Parameters) -> None:
    chosen = parameters.select(["ACL.reference_strain_pct", "ACL.stiffness_kN"])
    assert chosen.names == ("ACL.reference_strain_pct", "ACL.stiffness_kN")
    assert chosen.center.tolist() == [8.0, 10.0]
    assert chosen.is_log.tolist() == [False, True]


def test_bounds_can_be_narrowed(parameters: Parameters) -> None:
    narrow = parameters.with_bounds({"ACL.stiffness_kN": (5.0, 15.0)})
    assert (narrow.lower[0], narrow.upper[0]) == (5.0, 15.0)
    np.testing.assert_array_equal(narrow.lower[1:], parameters.lower[1:])
    with pytest.raises(ValueError, match=r"ACL\.stiffness_kN.*5.*5"):
        parameters.with_bounds({"ACL.stiffness_kN": (5.0, 5.0)})


def test_an_unknown_name_lists_the_known(parameters: Parameters) -> None:
    with pytest.raises(ValueError, match=r"'PCL'.*ACL\.stiff"):
        parameters.index("PCL")


def test_names_must_differ() -> None:
    with pytest.raises(ValueError, match=r"names.*differ"):
        ligament_parameters(["ACL", "ACL"], [1.0, 2.0], [0.0, 0.0])


def test_arrays_are_read_only_copies(parameters: Parameters) -> None:
    with pytest.raises(ValueError, match="read-only"):
        parameters.center[0] = 1.0
