"""Each load is the slope of a potential, stated once in words and here in vectors."""

import numpy as np
import pytest
from energy_evaluation import central_difference
from hypothesis import given
from hypothesis import strategies as st

from identknee.laxity.protocol import LOADS, Protocol
from identknee.mechanics.pose import coordinates_from_pose, rotation_matrix
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

# Central differences with a step of 1e-5 of potentials up to 1e6 N mm.
DIFFERENCE = 1e-6

poses = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.8, 0.8), *[st.floats(-30.0, 30.0)] * 3).map(
    np.array
)
flexions = st.floats(-0.1, 2.5)


def _axes(flexion: float, pose: Array) -> tuple[Array, Array, Array]:
    """Femoral lateral e1, floating anterior e2 and tibial superior e3, in femoral axes."""
    lateral, superior = np.array([0.0, 0.0, 1.0]), rotation_matrix(flexion, *pose[:2])[:, 1]
    floating = np.cross(superior, lateral)
    return lateral, floating / np.linalg.norm(floating), superior


def _origin(flexion: float, pose: Array) -> Array:
    return rotation_matrix(flexion, 0.0, 0.0) @ pose[2:]


def _work(column: str, flexion: float, pose: Array) -> float:
    """Minus the potential of a unit load [N mm per N or N mm]."""
    lateral, floating, _ = _axes(flexion, pose)
    down = -rotation_matrix(flexion, 0.0, 0.0)[:, 1]
    return {
        "internal_moment_Nm": 1000.0 * float(pose[1]),
        "varus_moment_Nm": 1000.0 * float(pose[0]),
        "anterior_force_N": float(_origin(flexion, pose) @ floating),
        "distraction_force_N": float(_origin(flexion, pose) @ down),
        "lateral_force_N": float(_origin(flexion, pose) @ lateral),
    }[column]


@given(
    flexion=flexions,
    pose=poses,
    loads=st.tuples(*[st.floats(-50.0, 50.0)] * 2, *[st.floats(-1000.0, 1000.0)] * 3).map(np.array),
)
def test_generalised_loads_are_slopes_of_the_stated_potentials(
    reference_model: LaxityModel, flexion: float, pose: Array, loads: Array
) -> None:
    protocol = Protocol(name="one", trials=("one",), flexion_deg=np.zeros(1), loads=loads[None])
    model = reference_model.with_protocol(protocol)
    generalised = model.paths.loads[model.paths.trial_node[0]]

    def work(at: Array) -> Array:
        parts = (load * _work(x, flexion, at) for x, load in zip(LOADS, loads, strict=True))
        return np.array(sum(parts))

    expected = [central_difference(work, pose, k, 1e-5) for k in range(5)]
    size = max(np.abs(loads[:2]).max() * 1000.0, np.abs(loads[2:]).max(), 1.0)
    assert generalised == pytest.approx(np.array(expected), abs=DIFFERENCE * size)


@given(flexion=flexions, pose=poses)
def test_moments_turn_about_the_axes_of_their_angles(flexion: float, pose: Array) -> None:
    """A moment about e2 does work on varus alone, one about e3 on internal rotation alone."""
    lateral, floating, superior = _axes(flexion, pose)
    step = 1e-6
    for index, axis in ((0, floating), (1, superior)):
        move = np.zeros(5)
        move[index] = step
        ahead = rotation_matrix(flexion, *(pose + move)[:2])
        behind = rotation_matrix(flexion, *(pose - move)[:2])
        turn = (ahead - behind) / (2 * step) @ rotation_matrix(flexion, *pose[:2]).T
        rate = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
        assert rate == pytest.approx(axis, abs=1e-8)
    assert floating @ lateral == pytest.approx(0.0, abs=1e-12)
    assert floating @ superior == pytest.approx(0.0, abs=1e-12)


@given(flexion=flexions, pose=poses)
def test_forces_work_on_the_translations_they_are_named_after(flexion: float, pose: Array) -> None:
    """An anterior force on anterior drawer alone; the others on theirs, at zero varus exactly."""
    anterior = _work("anterior_force_N", flexion, pose)
    assert anterior == pytest.approx(coordinates_from_pose(pose)[1], abs=1e-10)
    straight = pose * [0.0, 1.0, 1.0, 1.0, 1.0]
    shift, _, distraction, _, _ = coordinates_from_pose(straight)
    assert _work("lateral_force_N", flexion, straight) == pytest.approx(shift, abs=1e-10)
    assert _work("distraction_force_N", flexion, straight) == pytest.approx(distraction, abs=1e-10)
