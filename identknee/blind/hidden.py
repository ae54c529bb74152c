"""A hidden effect as drawn for one case, and the anatomical sites of structures."""

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
from identknee.runs.declare import Array, BoolArray, IntArray, declared, entry
from identknee.subject.knee import Knee

# Distance between the epicondyles of the average knee to which the offsets below refer [mm].
EPICONDYLES_MM = 83.0


@declared
class AnatomicalSites:
    """Anatomy of a right knee in its scanned pose [mm], points of each bone in its frame."""

    scale: float = entry("Size of the knee over that of an average one")
    medial: int = entry("Index of the medial collateral ligament among the ligaments")
    lateral: int = entry("Index of the lateral collateral ligament")
    front: int = entry("Index of the anterior cruciate ligament")
    rear: int = entry("Index of the posterior cruciate ligament")
    epicondyles: Array = entry(
        "Medial and lateral femoral end of the collaterals, shape ``(2, 3)``"
    )
    plateaus: Array = entry(
        "Lowest corner, centroid and highest corner of the medial and lateral plateau, shape "
        "``(2, 3, 3)``"
    )
    fibula: Array = entry("Distal end of the lateral collateral ligament, shape ``(3,)``")
    femur: Array = entry("Lowest and highest corner of the femoral surface, shape ``(2, 3)``")


def anatomical_sites(knee: Knee) -> AnatomicalSites:
    """Anatomy of a knee.

    The collaterals are the ligaments farthest to either side; of the others the anterior cruciate
    runs most forward on its way down, and the posterior cruciate most backward.
    """
    femoral = np.array([knee.femur_frame.to_local(x.femur) for x in knee.ligaments])
    tibial = np.array([knee.tibia_frame.to_local(x.tibia) for x in knee.ligaments])
    across = femoral[:, 2] + tibial[:, 2]
    medial, lateral = int(np.argmin(across)), int(np.argmax(across))
    forward = tibial[:, 0] - femoral[:, 0] - 1e-3 * np.abs(across)
    is_outer = np.abs(across) > 0.6 * np.abs(across[[medial, lateral]]).mean()
    front = int(np.argmax(np.where(is_outer, -np.inf, forward)))
    rear = int(np.argmin(np.where(is_outer, np.inf, forward)))
    plateaus = sorted(
        (knee.tibia_frame.to_local(x.vertices) for x in knee.tibia), key=lambda x: x[:, 2].mean()
    )
    femur = knee.femur_frame.to_local(knee.femur.vertices)
    return AnatomicalSites(
        scale=float(femoral[lateral, 2] - femoral[medial, 2]) / EPICONDYLES_MM,
        medial=medial,
        lateral=lateral,
        front=front,
        rear=rear,
        epicondyles=femoral[[medial, lateral]],
        plateaus=np.array([[x.min(axis=0), x.mean(axis=0), x.max(axis=0)] for x in plateaus]),
        fibula=tibial[lateral],
        femur=np.array([femur.min(axis=0), femur.max(axis=0)]),
    )


def structure_insertions(places: AnatomicalSites) -> dict[str, tuple[Array, Array]]:
    """Femoral and tibial end of each structure a four-line knee lacks [mm], shape ``(3,)`` each.

    References
    ----------
    .. [1] Kennedy et al. (2015), Am. J. Sports Med. 43(7), 1606-1615 (anterolateral ligament).
           https://doi.org/10.1177/0363546515578253
    .. [2] LaPrade et al. (2007), J. Bone Joint Surg. 89(9), 2000-2010 (medial side).
           https://doi.org/10.2106/JBJS.F.01176
    .. [3] LaPrade et al. (2003), Am. J. Sports Med. 31(6), 854-860 (posterolateral side).
           https://doi.org/10.1177/03635465030310062101
    """
    s = places.scale
    medial, lateral = places.epicondyles
    (low_m, mid_m, _), (low_l, mid_l, high_l) = places.plateaus
    behind = places.femur[0, 0] - 1.0 * s
    return {
        "anterolateral": (
            lateral + s * np.array([-4.0, 4.0, 0.0]),
            np.array([places.fibula[0] + 22.0 * s, mid_l[1] - 8.0 * s, high_l[2] + 1.0 * s]),
        ),
        "posteromedial": (
            medial + s * np.array([-8.0, 0.0, 3.0]),
            np.array([low_m[0] + 2.0 * s, mid_m[1] - 5.0 * s, low_m[2] + 5.0 * s]),
        ),
        "popliteofibular": (
            lateral + s * np.array([3.0, -7.0, -3.0]),
            places.fibula + s * np.array([-4.0, 6.0, -5.0]),
        ),
        "deep_mcl": (
            medial + s * np.array([1.0, -7.0, 3.0]),
            np.array([mid_m[0], mid_m[1] - 6.0 * s, low_m[2] - 1.0 * s]),
        ),
        "posterior_capsule_medial": (
            np.array([behind, 8.0 * s, mid_m[2] - 3.0 * s]),
            np.array([low_m[0] - 2.0 * s, mid_m[1] - 9.0 * s, mid_m[2] - 1.0 * s]),
        ),
        "posterior_capsule_lateral": (
            np.array([behind, 8.0 * s, mid_l[2] - 1.0 * s]),
            np.array([low_l[0] - 2.0 * s, mid_l[1] - 9.0 * s, mid_l[2]]),
        ),
    }


@declared
class Scene:
    """The knee and the trials that an effect is drawn for."""

    places: AnatomicalSites = entry("Anatomy of the knee")
    n_lines: int = entry("How many ligaments the knee has")
    start: tuple[Array, Array] = entry(
        "Rotation and position of the tibia in the femur in the scanned pose"
    )
    load_Nm: Array = entry("Stated internal and varus moment of each trial [N·m], shape ``(n, 2)``")  # noqa: N815 - newton metres
    order: IntArray = entry("When each trial was made, 1 to n")
    is_unloading: BoolArray = entry("Whether the load was coming down, shape ``(n,)``")
    conditions: Conditions = entry("Distributions of insertions and slack strains")


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
        "Number of components with equal spread whose norm is the amplitude", default=1
    )
    over: float = entry(
        "Divisor of that norm: the root of the number of components for a root mean square",
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

    `size` is the unit of the amplitude, then its smallest and its largest value in the literature.
    `shares` are the parameters over the amplitude, in its unit or with their own. `more` has
    further fields of `Hidden`.
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
