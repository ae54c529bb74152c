"""A hidden effect as drawn for one case: what it does to an experiment at any amplitude."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from identknee.blind.conditions import Conditions
from identknee.blind.experiment import (
    FEMUR_END,
    LINE_COLUMNS,
    REFERENCE_LENGTH,
    REFERENCE_STRAIN,
    STIFFNESS,
    TIBIA_END,
    TOE,
    TOE_STRAIN,
    Experiment,
)
from identknee.blind.sites import Places
from identknee.runs.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """What an effect is drawn for.

    Attributes
    ----------
    places
        Anatomy of the knee.
    n_lines
        How many ligaments the knee has.
    start
        Rotation and position of the tibia in the femur in the scanned pose.
    load_Nm
        Stated internal and varus moment of each trial [N·m], shape ``(n, 2)``.
    order
        When each trial was made, 1 to n.
    is_unloading
        Whether the load was coming down, shape ``(n,)``.
    conditions
        What places and slack strains are drawn from.
    """

    places: Places
    n_lines: int
    start: tuple[Array, Array]
    load_Nm: Array  # noqa: N815 - newton metres
    order: IntArray
    is_unloading: BoolArray
    conditions: Conditions


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hidden:
    """An effect drawn for one case; its amplitude is still open.

    Attributes
    ----------
    name, unit
        Which effect, and the unit of its amplitude.
    smallest, largest
        Sizes found in the literature; the largest is also the end of a search for a signal.
    sign
        Sign of the amplitude.
    apply
        An experiment with the effect at a signed amplitude.
    amplitudes
        Every number of the effect at a signed amplitude: value and unit by the name that the
        library has for it.
    line
        Femoral and tibial end of a line structure in the bones' frames [mm].
    n_numbers
        How many numbers of equal spread the amplitude is the length of.
    over
        What that length is divided by: a root mean square has the root of their number.
    """

    name: str
    unit: str
    smallest: float
    largest: float
    sign: float = 1.0
    apply: Callable[[Experiment, float], Experiment]
    amplitudes: Callable[[float], Mapping[str, tuple[float, str]]]
    line: tuple[Array, Array] | None = None
    n_numbers: int = 1
    over: float = 1.0


Apply = Callable[[Experiment, float], Experiment]
Draw = Callable[[Scene, np.random.Generator], Hidden]


def line_row(
    scene: Scene, femur: Array, tibia: Array, stiffness_kN: float, strain_pct: float
) -> Array:
    """Row of an experiment's lines, its reference length measured in the scanned pose."""
    R, t = scene.start
    row = np.zeros(LINE_COLUMNS)
    row[FEMUR_END], row[TIBIA_END] = femur, tibia
    row[REFERENCE_LENGTH] = np.linalg.norm(R @ tibia + t - femur)
    row[STIFFNESS], row[REFERENCE_STRAIN] = 1000.0 * stiffness_kN, 0.01 * strain_pct
    row[TOE] = TOE_STRAIN
    return row
