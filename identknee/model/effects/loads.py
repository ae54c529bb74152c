"""Errors of the loads: those that acted differ from those recorded, or muscles pull as well."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from identknee.model.effects.effect import effect_of
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, declared, entry
from identknee.subject.anatomy import anatomy
from identknee.subject.knee import Knee

VARUS, INTERNAL, X, Y, Z = range(5)
PER_NM = 1000.0  # N mm
Change = Callable[[Array, Array, Array], Array]


@declared
class LoadError:
    """An effect that turns the stated loads into those that acted."""

    name: str = entry("Name of the cause")
    parameters: Parameters = entry("Its amplitudes")
    acted: Change = entry(
        "The loads that acted, from loads (n, 5), flexion [rad] (n,) and amplitudes"
    )

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the loads that acted."""
        return replace(setting, loads=self.acted(setting.loads, setting.flexion, values))

    @property
    def is_on_unloaded_knee(self) -> bool:
        """Whether a load acts where none is stated, as the weight of the shank does."""
        p = self.parameters
        return bool(self.acted(np.zeros((1, 5)), np.zeros(1), p.center + p.prior_sd).any())


def compression() -> LoadError:
    """A constant axial force on the joint: muscle tone, or the weight that seats the knee [N]."""
    return effect_of(
        *(LoadError, "compression", ["force_N"], [60.0]),
        lower=[-60.0],
        upper=[300.0],
        acted=_compressed,
    )


def shank_gravity() -> LoadError:
    """The weight of shank and foot, where the loads were not corrected for it [N].

    Its two components are distal along the femur and posterior. They are fixed to the femur, which
    the rig holds.
    """
    names, limits = ["distal_N", "posterior_N"], [40.0, 40.0]
    return effect_of(LoadError, "shank_gravity", names, [15.0, 15.0], upper=limits, acted=_weighted)


def moment_gain(axis: str) -> LoadError:
    """A wrong scale of the moments about one axis, ``"IE"`` or ``"VV"`` [-]."""
    acted = partial(_scaled, {"IE": INTERNAL, "VV": VARUS}[axis])
    return effect_of(LoadError, f"moment_gain_{axis}", ["gain"], [0.1], upper=[0.5], acted=acted)


def moment_offset() -> LoadError:
    """A zero error of both moments [N·m]."""
    names = ["IE_Nm", "VV_Nm"]
    return effect_of(LoadError, "moment_offset", names, [0.3, 0.3], upper=[1.5, 1.5], acted=_offset)


def axis_misalignment() -> LoadError:
    """Misaligned axes of the moments: a part of each moment acts about the other axis [deg]."""
    names, limits = ["IE_to_VV_deg", "VV_to_IE_deg"], [15.0, 15.0]
    return effect_of(
        LoadError, "axis_misalignment", names, [4.0, 4.0], upper=limits, acted=_misaligned
    )


def parasitic_shear() -> LoadError:
    """Forces that come with the moments, anterior and lateral [N/N·m]."""
    names = [f"{axis}_{towards}_N_per_Nm" for axis in ("IE", "VV") for towards in ("x", "z")]
    return effect_of(
        LoadError, "parasitic_shear", names, 4 * [0.6], upper=4 * [3.0], acted=_sheared
    )


def _compressed(loads: Array, _flexion: Array, values: Array) -> Array:
    acted = np.array(loads)
    acted[:, Y] += values[0]
    return acted


def _weighted(loads: Array, flexion: Array, values: Array) -> Array:
    acted = np.array(loads)
    distal, posterior = values
    # From femoral axes into those turned with flexion.
    acted[:, X] += -posterior * np.cos(flexion) + distal * np.sin(flexion)
    acted[:, Y] += -posterior * np.sin(flexion) - distal * np.cos(flexion)
    return acted


def _scaled(column: int, loads: Array, _flexion: Array, values: Array) -> Array:
    acted = np.array(loads)
    acted[:, column] *= 1.0 + values[0]
    return acted


def _offset(loads: Array, _flexion: Array, values: Array) -> Array:
    acted = np.array(loads)
    acted[:, INTERNAL] += PER_NM * values[0]
    acted[:, VARUS] += PER_NM * values[1]
    return acted


def _misaligned(loads: Array, _flexion: Array, values: Array) -> Array:
    internal_to_varus, varus_to_internal = np.radians(values)
    acted = np.array(loads)
    acted[:, VARUS] += np.sin(internal_to_varus) * loads[:, INTERNAL]
    acted[:, INTERNAL] += np.sin(varus_to_internal) * loads[:, VARUS]
    return acted


def _sheared(loads: Array, _flexion: Array, values: Array) -> Array:
    acted = np.array(loads)
    per = values.reshape(2, 2) / PER_NM
    acted[:, [X, Z]] += np.outer(loads[:, INTERNAL], per[0]) + np.outer(loads[:, VARUS], per[1])
    return acted


MUSCLES = ("quadriceps", "hamstrings", "gastrocnemius")
# Angle of the patellar tendon before the tibia's axis in extension, and how it falls with flexion.
TENDON_DEG, TENDON_SLOPE = 20.0, 0.3
# The same angle of the gastrocnemius, at any flexion.
GASTROCNEMIUS_DEG = 3.0
# Lateral of the middle of both plateaus [mm]: where each line crosses the joint in a typical knee.
# Medial hamstrings and the medial head of the gastrocnemius are about twice the lateral ones.
LATERAL = (5.0, -2.0, -7.0)
TONE_SD, MOST_TONE = 60.0, 300.0  # N
# How far lines of action are from there, in place and direction, and the most that is plausible.
LATERAL_SD, LEAN_SD, MOST_SDS = 5.0, 3.0, 3.0  # mm, deg


def muscle_tension(knee: Knee) -> LoadError:
    """Constant pulls of the quadriceps, the hamstrings and the gastrocnemius [N], as in vivo.

    The quadriceps pulls on the tibia along the patellar tendon, whose angle falls with flexion
    [1]_. The hamstrings pull along the femur, the gastrocnemius nearly along the tibia. Where they
    cross the joint is an estimate, so each line may lie further to one side [mm] or lean forward
    [deg]. No muscle pushes.

    References
    ----------
    .. [1] W. Herzog and L. J. Read, Lines of action and moment arms of the major force-carrying
           structures crossing the human knee joint, J. Anat. 182 (1993) 213-230.
    """
    found = anatomy(knee)
    places = [knee.tibia_frame.to_local(x.plateau_centre)[2] for x in found.compartments]
    lateral = np.mean(places) + found.size * np.array(LATERAL)
    spread = [*3 * [LATERAL_SD], *3 * [LEAN_SD]]
    farthest = [MOST_SDS * x for x in spread]
    return effect_of(
        LoadError,
        "muscle_tension",
        [f"{x}_{what}" for what in ("N", "lateral_mm", "forward_deg") for x in MUSCLES],
        [*3 * [TONE_SD], *spread],
        lower=[*3 * [0.0], *(-x for x in farthest)],
        upper=[*3 * [MOST_TONE], *farthest],
        acted=partial(_pulled, lateral),
    )


def _pulled(places: Array, loads: Array, flexion: Array, values: Array) -> Array:
    tension, aside, lean = values.reshape(3, len(MUSCLES))
    lateral = places + aside
    forward = np.stack(
        [
            np.radians(TENDON_DEG) - TENDON_SLOPE * flexion,
            -flexion,
            np.full(len(flexion), np.radians(GASTROCNEMIUS_DEG)),
        ],
        axis=1,
    )
    forward += np.radians(lean)
    ahead, up = tension * np.sin(forward), tension * np.cos(forward)
    acted = np.array(loads)
    acted[:, X] += ahead.sum(axis=1)
    acted[:, Y] += up.sum(axis=1)
    acted[:, VARUS] -= up @ lateral
    acted[:, INTERNAL] += ahead @ lateral
    return acted
