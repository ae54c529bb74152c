"""A branch leaves its tangent to second order."""

import numpy as np
import pytest
from energy_evaluation import SCALE, random_parameters
from tolerances import ORDER

from identknee.laxity.protocol import Protocol
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

# Each point that begins to touch bends the branch a little, so that single steps scatter: the order
# is that of the median over eight halvings.
SHARES = 2.0 ** -np.arange(8.0)
STEP_NM = 1.0


def _order(sizes: Array) -> float:
    """Of the median over the rows of `sizes`, a column a share."""
    return float(np.polyfit(np.log(SHARES), np.log(np.median(sizes, axis=0)), 1)[0])


def _ramp(flexion: float, start: float) -> Protocol:
    loads = np.zeros((9, 5))
    loads[:, 0] = start + STEP_NM * np.r_[0.0, SHARES]
    return Protocol(
        name="ramp", trials=tuple("abcdefghi"), flexion_deg=np.full(9, flexion), loads=loads
    )


def _off_tangent(model: LaxityModel, flexion: float, start: float) -> Array:
    """Distance from the tangent after each share of a step [mm]."""
    found = model.with_protocol(_ramp(flexion, start)).predict(model.parameters.center)
    assert found.all_converged
    assert found.hessians is not None
    tangent = np.linalg.solve(found.hessians[0], [0.0, 1000.0 * STEP_NM, 0.0, 0.0, 0.0])
    change = found.poses[1:] - found.poses[0] - SHARES[:, None] * tangent
    return np.asarray(np.linalg.norm(change * SCALE, axis=1))


def test_equilibria_leave_the_tangent_to_second_order(reference_model: LaxityModel) -> None:
    sizes = [
        _off_tangent(reference_model, flexion, start)
        for flexion in (0.0, 15.0, 30.0, 45.0, 60.0)
        for start in (-7.0, -5.0, -3.0, -1.0, 1.0, 3.0, 5.0, 7.0)
    ]
    assert _order(np.array(sizes)) == pytest.approx(2.0, abs=ORDER)


def test_the_jacobian_predicts_to_second_order(reference_model: LaxityModel) -> None:
    """The same along lines through the parameters."""
    rng, theta = np.random.default_rng(0), reference_model.parameters.center
    found = reference_model.predict(theta)
    assert found.jacobian is not None
    sizes = []
    for _ in range(6):
        direction = random_parameters(reference_model, rng, share=0.05, pct=0.6) - theta
        off = [
            reference_model.predict(theta + share * direction, derivatives=False).coordinates
            - found.coordinates
            - share * found.jacobian @ direction
            for share in SHARES
        ]
        sizes.append(np.abs(off).reshape(len(SHARES), -1).T)
    assert _order(np.concatenate(sizes)) == pytest.approx(2.0, abs=ORDER)
