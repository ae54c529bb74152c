"""Effects on loads and flexion: the same as another protocol."""

from dataclasses import replace

import numpy as np
import pytest
from tolerances import SAME_POSE

from identknee.laxity.protocol import LOADS, load_protocol
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.knee import Knee

# Trials of both axes, spread over the protocol.
PROTOCOL = load_protocol("seed63").select(np.arange(0, 63, 6))


def coordinates(knee: Knee, name: str, values: list[float]) -> Array:
    model = LaxityModel(knee=knee, protocol=PROTOCOL, effects=(effect_named(knee, name),))
    theta = np.r_[model.parameters.center[: model.n_ligament_parameters], values]
    return model.predict(theta, derivatives=False).coordinates


def under(knee: Knee, *, loads: Array | None = None, flexion: Array | None = None) -> Array:
    protocol = replace(
        PROTOCOL,
        loads=PROTOCOL.loads if loads is None else loads,
        flexion_deg=PROTOCOL.flexion_deg if flexion is None else flexion,
    )
    model = LaxityModel(knee=knee, protocol=protocol)
    return model.predict(model.parameters.center, derivatives=False).coordinates


def added(**loads: float) -> Array:
    """The loads of the protocol and these."""
    return PROTOCOL.loads + [loads.get(x, 0.0) for x in LOADS]


@pytest.mark.parametrize(
    ("axis", "load"), [("IE", "internal_moment_Nm"), ("VV", "varus_moment_Nm")]
)
def test_a_gain_of_a_tenth_is_a_tenth_more_load(axis: str, load: str, reference: Knee) -> None:
    loads = np.array(PROTOCOL.loads)
    loads[:, LOADS.index(load)] *= 1.1
    found = coordinates(reference, f"moment_gain_{axis}", [0.1])
    assert np.abs(found - under(reference, loads=loads)).max() <= SAME_POSE


def test_an_offset_is_the_same_moment_in_all_trials(reference: Knee) -> None:
    wanted = under(reference, loads=added(internal_moment_Nm=0.4, varus_moment_Nm=-0.3))
    found = coordinates(reference, "moment_offset", [0.4, -0.3])
    assert np.abs(found - wanted).max() <= SAME_POSE


def test_compression_is_a_force_against_distraction(reference: Knee) -> None:
    found = coordinates(reference, "compression", [80.0])
    wanted = under(reference, loads=added(distraction_force_N=-80.0))
    assert np.abs(found - wanted).max() <= SAME_POSE


def test_compression_shrinks_varus_laxity(reference: Knee) -> None:
    """Both condyles lift off later; how far the knee turns is another matter."""
    free, pressed = (
        np.ptp(coordinates(reference, "compression", [force])[:, 3]) for force in (0.0, 50.0)
    )
    assert pressed < free - 0.1


def test_gravity_pulls_a_straight_knee_apart(reference: Knee) -> None:
    """At full extension the distal part distracts; bent by 90 deg it pulls forwards."""
    model = LaxityModel(
        knee=reference,
        protocol=replace(
            PROTOCOL.select([0, 1]), flexion_deg=np.array([0.0, 90.0]), loads=np.zeros((2, 5))
        ),
        effects=(effect_named(reference, "shank_gravity"),),
    )
    theta = model.parameters.vector({"shank_gravity.distal_N": 30.0})
    loads = model.setting(theta).loads[model.paths.trial_node]
    np.testing.assert_allclose(loads, [[0, 0, 0, -30.0, 0], [0, 0, 30.0, 0, 0]], atol=1e-12)


def test_an_offset_of_flexion_is_another_angle(reference: Knee) -> None:
    wanted = under(reference, flexion=PROTOCOL.flexion_deg + 3.0)
    found = coordinates(reference, "flexion_offset", [3.0])
    assert np.abs(found - wanted).max() <= SAME_POSE


def acted(knee: Knee, **amplitudes: float) -> Array:
    """Generalised loads on (varus, internal [N mm], x, y, z [N]) that acted in each trial."""
    (name,) = {x.partition("__")[0] for x in amplitudes}
    model = LaxityModel(knee=knee, protocol=PROTOCOL, effects=(effect_named(knee, name),))
    theta = model.parameters.vector({k.replace("__", "."): v for k, v in amplitudes.items()})
    return np.asarray(model.setting(theta).loads[model.paths.trial_node])


def change(knee: Knee, **amplitudes: float) -> Array:
    """What an effect adds to them."""
    return acted(knee, **amplitudes) - acted(knee, **dict.fromkeys(amplitudes, 0.0))


INTERNAL_NM, VARUS_NM = (
    PROTOCOL.loads[:, LOADS.index(x)] for x in ("internal_moment_Nm", "varus_moment_Nm")
)


def test_a_misaligned_axis_turns_the_sine_of_a_moment_into_the_other(reference: Knee) -> None:
    """An internal moment of 10 N·m at 5 deg is one of 0.87 N·m into varus as well, not away."""
    one = change(reference, axis_misalignment__IE_to_VV_deg=5.0)
    np.testing.assert_allclose(one[:, 0], 1000.0 * np.sin(np.radians(5.0)) * INTERNAL_NM)
    np.testing.assert_allclose(one[:, 1:], 0.0, atol=1e-9)
    other = change(reference, axis_misalignment__VV_to_IE_deg=5.0)
    np.testing.assert_allclose(other[:, 1], 1000.0 * np.sin(np.radians(5.0)) * VARUS_NM)
    np.testing.assert_allclose(np.delete(other, 1, 1), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("axis", "moment"), [("IE", INTERNAL_NM), ("VV", VARUS_NM)], ids=["IE", "VV"]
)
@pytest.mark.parametrize(("towards", "column"), [("x", 2), ("z", 4)])
def test_shear_is_so_many_newtons_for_each_newton_metre(
    axis: str, moment: Array, towards: str, column: int, reference: Knee
) -> None:
    """1 N/N·m at 10 N·m is 10 N, forwards or to the lateral side where the moment is positive."""
    found = change(reference, **{f"parasitic_shear__{axis}_{towards}_N_per_Nm": 1.0})
    np.testing.assert_allclose(found[:, column], moment, atol=1e-9)
    np.testing.assert_allclose(np.delete(found, column, 1), 0.0, atol=1e-9)


def test_weight_hangs_the_same_way_in_the_femur_at_all_angles(reference: Knee) -> None:
    """In axes turned with flexion, which the loads are given in, the femur's turn back by it."""
    flexion = np.radians(PROTOCOL.flexion_deg)
    cos, sin, zero = np.cos(flexion), np.sin(flexion), 0.0 * flexion
    # The femur's axes turned by minus flexion about z: a vector v there is Rz(flexion) v here.
    backwards = np.column_stack([-cos, -sin, zero])
    down = np.column_stack([sin, -cos, zero])
    for part, way in (("posterior_N", backwards), ("distal_N", down)):
        found = change(reference, **{f"shank_gravity__{part}": 20.0})
        np.testing.assert_allclose(found[:, 2:], 20.0 * way, atol=1e-9)
        np.testing.assert_allclose(found[:, :2], 0.0, atol=1e-9)
