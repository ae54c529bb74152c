"""A knee held at a pose by a spring that lets go ends where its load path ends."""

from dataclasses import replace

import numpy as np
from small_knee import small_knee, small_protocol

from identknee.mechanics.memory import CONVERGED
from identknee.mechanics.pose import pose_from_coordinates
from identknee.model.laxity_model import LaxityModel
from identknee.model.mechanics_inputs import holding_poses
from identknee.runs.declare import Array

OFF = np.array([2.0, 1.0, -1.5, 3.0, -4.0])  # mm and deg


def models() -> tuple[LaxityModel, LaxityModel, Array]:
    """A model on load paths, and one that is released from poses near their ends; theta."""
    model = LaxityModel(knee=small_knee(), protocol=small_protocol())
    theta = model.parameters.start
    ends = model.predict(theta).coordinates
    return model, replace(model, poses=pose_from_coordinates(ends + OFF)), theta


def test_released_equilibria_are_those_at_the_ends_of_load_paths() -> None:
    on_paths, released, theta = models()
    first, second = on_paths.predict(theta), released.predict(theta)
    assert (second.codes == CONVERGED).all()
    np.testing.assert_array_equal(second.released, 1.0)
    np.testing.assert_allclose(second.coordinates, first.coordinates, rtol=0.0, atol=1e-10)
    assert first.jacobian is not None
    assert second.jacobian is not None
    np.testing.assert_allclose(second.jacobian, first.jacobian, rtol=0.0, atol=1e-7)


def test_a_knee_that_gives_way_is_held_where_the_spring_balances_it() -> None:
    """One crossed ligament alone holds no knee, but it moves a knee that is held."""
    _, released, theta = models()
    slack = np.array(theta)
    slack[[4, 6, 7]] = -30.0
    found = released.predict(slack)
    lost = ~found.is_converged
    assert lost.any()
    assert np.isnan(found.coordinates[lost]).all()
    held = found.released[lost]
    assert ((held > 0.0) & (held < 1.0)).all()
    assert found.held_jacobian is not None
    assert np.abs(found.held_jacobian[lost]).max() > 0.1
    for i in range(slack.size):
        step = np.zeros(slack.size)
        step[i] = 1e-5
        ends = [released.predict(slack + sign * step).held_coordinates for sign in (-1.0, 1.0)]
        change = (ends[1] - ends[0]) / 2e-5
        np.testing.assert_allclose(found.held_jacobian[lost, :, i], change[lost], atol=1e-5)


def test_an_unmeasured_coordinate_is_held_where_the_nearest_trial_has_it() -> None:
    model, _, theta = models()
    laxity = model.simulate(theta)
    coordinates = np.array(laxity.coordinates)
    coordinates[0, 3] = np.nan
    angles = laxity.protocol.flexion_deg
    nearest = 1 + int(np.argmin(np.abs(angles[1:] - angles[0])))
    poses = holding_poses(model.joint.start, replace(laxity, coordinates=coordinates))
    coordinates[0, 3] = coordinates[nearest, 3]
    np.testing.assert_allclose(poses, pose_from_coordinates(coordinates))
