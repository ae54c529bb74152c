"""Problems with other bounds than their model's."""

from dataclasses import dataclass

import numpy as np
import pytest

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import with_bounds
from identknee.model.parameters import Parameters, ligament_parameters
from identknee.runs.declare import Array


@dataclass(frozen=True)
class Pull:
    """Residuals are the distance from 12 kN and 1 %."""

    parameters: Parameters

    def residuals(self, theta: Array) -> Array:
        return theta - [12.0, 1.0]

    def jacobian(self, theta: Array) -> Array:
        return np.eye(2)


def a_pull() -> Pull:
    return Pull(parameters=ligament_parameters(["ACL"], [10.0], [8.0]))


def test_a_fit_stays_in_the_bounds_given() -> None:
    problem = with_bounds(a_pull(), {"ACL.stiffness_kN": (5.0, 11.0)})
    found = fit(problem, [10.0, 8.0])
    # The constrained minimum of a separable problem is the free one cut to the bounds.
    np.testing.assert_allclose(found.theta, [11.0, 1.0], atol=1e-9)
    assert found.at_bounds == ("ACL.stiffness_kN",)


def test_other_parameters_keep_their_bounds() -> None:
    given = a_pull()
    bounded = with_bounds(given, {"ACL.stiffness_kN": (5.0, 11.0)}).parameters
    assert bounded.lower[1] == given.parameters.lower[1]
    assert bounded.upper[1] == given.parameters.upper[1]


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ValueError, match=r"'PCL\.stiffness_kN'"):
        with_bounds(a_pull(), {"PCL.stiffness_kN": (0.0, 1.0)})


def test_bounds_the_wrong_way_round_are_refused() -> None:
    with pytest.raises(ValueError, match=r"ACL\.stiffness_kN.*11.*5"):
        with_bounds(a_pull(), {"ACL.stiffness_kN": (11.0, 5.0)})


def test_a_stiffness_cannot_be_allowed_to_be_negative() -> None:
    with pytest.raises(ValueError, match=r"lower.*ACL\.stiffness_kN.*0"):
        with_bounds(a_pull(), {"ACL.stiffness_kN": (-1.0, 5.0)})
