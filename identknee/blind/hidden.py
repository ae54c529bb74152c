"""A hidden effect as drawn for one case: what it does to an experiment at any amplitude."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

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
from identknee.blind.sites import AnatomicalSites
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import declared, entry


@declared
class Scene:
    """What an effect is drawn for."""

    places: AnatomicalSites = entry("Anatomy of the knee")
    n_lines: int = entry("How many ligaments the knee has")
    start: tuple[Array, Array] = entry(
        "Rotation and position of the tibia in the femur in the scanned pose"
    )
    load_Nm: Array = entry("Stated internal and varus moment of each trial [N·m], shape ``(n, 2)``")  # noqa: N815 - newton metres
    order: IntArray = entry("When each trial was made, 1 to n")
    is_unloading: BoolArray = entry("Whether the load was coming down, shape ``(n,)``")
    conditions: Conditions = entry("What places and slack strains are drawn from")


@declared
class Hidden:
    """An effect drawn for one case; its amplitude is still open."""

    name: str = entry("Name of the effect")
    unit: str = entry("Unit of its amplitude")
    smallest: float = entry("Smallest size found in the literature")
    largest: float = entry("Largest size found there, also the end of a search for a signal")
    sign: float = entry("Sign of the amplitude", default=1.0)
    apply: Callable[[Experiment, float], Experiment] = entry(
        "An experiment with the effect at a signed amplitude"
    )
    amplitudes: Callable[[float], Mapping[str, tuple[float, str]]] = entry(
        "Every number of the effect at a signed amplitude: value and unit by the name that the "
        "library has for it"
    )
    line: tuple[Array, Array] | None = entry(
        "Femoral and tibial end of a line structure in the bones' frames [mm]", default=None
    )
    n_numbers: int = entry(
        "How many numbers of equal spread the amplitude is the length of", default=1
    )
    over: float = entry(
        "What that length is divided by: a root mean square has the root of their number",
        default=1.0,
    )


Apply = Callable[[Experiment, float], Experiment]
Draw = Callable[[Scene, np.random.Generator], Hidden]


def hidden(
    name: str,
    size: tuple[str, float, float],
    apply: Apply,
    shares: Mapping[str, float | tuple[float, str]],
    *,
    fixed: Mapping[str, tuple[float, str]] = MappingProxyType({}),
    **more: Any,
) -> Hidden:
    """An effect whose parameters are proportional to its amplitude, but for the `fixed` ones.

    `size` is the unit of the amplitude, then the smallest and the largest of the literature. A
    share is one of this unit, or comes with its own. `more` as in `Hidden`.
    """
    unit, smallest, largest = size
    by_name = {k: x if isinstance(x, tuple) else (x, unit) for k, x in shares.items()}
    return Hidden(
        name=name,
        unit=unit,
        smallest=smallest,
        largest=largest,
        apply=apply,
        amplitudes=lambda a: {**{k: (a * x, u) for k, (x, u) in by_name.items()}, **fixed},
        **more,
    )


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
