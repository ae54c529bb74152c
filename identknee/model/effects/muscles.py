"""Muscles that pull while a knee is tested: constant forces along their lines of action."""

from functools import partial

import numpy as np

from identknee.model.effects.effect import amplitudes
from identknee.model.effects.loads import INTERNAL, VARUS, LoadError, X, Y
from identknee.runs.arrays import Array
from identknee.subject.anatomy import anatomy
from identknee.subject.knee import Knee

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
    made = amplitudes(
        "muscle_tension",
        [f"{x}_{what}" for what in ("N", "lateral_mm", "forward_deg") for x in MUSCLES],
        [*3 * [TONE_SD], *spread],
        lower=[*3 * [0.0], *(-x for x in farthest)],
        upper=[*3 * [MOST_TONE], *farthest],
    )
    acted = partial(_pulled, lateral)
    return LoadError(name="muscle_tension", parameters=made, acted=acted)


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
