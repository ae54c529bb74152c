"""Laxity tables with one convention broken on purpose, and what should name it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import WhitenedResiduals
from identknee.checks.broken_convention import BrokenConvention
from identknee.checks.usable_trials import TrialSearch, defined_everywhere
from identknee.laxity.protocol import LOADS, Protocol, concatenate, load_protocol
from identknee.laxity.table import (
    COORDINATES,
    ROTATIONS,
    TRANSLATIONS,
    Laxity,
    add_noise,
    relative_to_unloaded,
)
from identknee.laxity.translations import Translations, from_components
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array
from identknee.subject.folder import example
from identknee.subject.knee import Uncertainty

NOISE = 0.5  # mm and deg
LENGTHS, ANGLES, FORCES = COORDINATES[TRANSLATIONS], COORDINATES[ROTATIONS], LOADS[2:]
SIDED, SIDED_LOADS = [0, 3, 4], [0, 1, 4]
# What the measured frames and the axes of loads may be off by without being a broken convention.
FRAMES = Uncertainty(registration_deg=2.0, registration_mm=2.0, load_axes_deg=2.0)


@dataclass(frozen=True, kw_only=True)
class Planted:
    """How a convention is broken, and what the change that puts it right is called by."""

    broken: Callable[[Laxity], Laxity]
    what: str

    def is_named(self, found: BrokenConvention | None) -> bool:
        """Whether it is named, and nothing else beside it."""
        return found is not None and self.what in found.what and not found.others


def clean_table(
    name: str, seed: int, *, noise: float = NOISE, protocol: Protocol | None = None
) -> tuple[LaxityModel, Laxity]:
    """A knee, and the laxity of one like it under rotations and drawers, with noise.

    Its stiffnesses differ from the subject's by 20 % and its reference strains by 1 % of strain.
    """
    used = rotations_and_drawers() if protocol is None else protocol
    model = LaxityModel(knee=example(name), protocol=used)
    made = drawn_laxity(model, model.parameters.center, np.random.default_rng(seed))
    return model, add_noise(made, sd_mm=noise, sd_deg=noise, seed=seed)


def rotations_and_drawers() -> Protocol:
    """69 trials on load curves of up to eleven points."""
    return concatenate([load_protocol("seed63"), load_protocol("drawer")], name="both")


def drawn_laxity(
    model: LaxityModel, center: Array, generator: np.random.Generator, *, least: float = 1.0
) -> Laxity:
    """Laxity without noise of a knee near `center`; a share `least` of its trials is stable."""
    own = model.parameters
    while True:
        draws = generator.standard_normal(own.n)
        theta = np.where(own.is_log, center * np.exp(0.2 * draws), center + draws)
        theta = np.clip(theta, own.lower, own.upper)
        made = model.simulate(theta)
        measured = made.is_measured.all(axis=1)
        if measured.mean() >= least:
            return made if measured.all() else made.select(measured)


def moved_by(model: LaxityModel, broken: Laxity, sd: float) -> float:
    """How far a broken convention moves a table without noise, in units of the noise.

    The root-mean-square of what is left of the worst coordinate once ligaments, frames and load
    axes were fitted. Infinite where the table put a trial beyond all equilibria.
    """
    knee = model.knee.with_uncertainty(FRAMES)
    extended = LaxityModel(knee=knee, protocol=broken.protocol).with_tests(broken)
    residuals = defined_everywhere(LaxityResiduals(model=extended, laxity=broken))
    start = extended.parameters.start
    search = TrialSearch(model=extended, laxity=broken, weighting="unit", bounds={})
    if extended.poses is not None:
        start = search.used(start).start
    problem = WhitenedResiduals(
        problem=residuals, sd=np.full(int(broken.is_measured.sum()) + broken.n, sd)
    )
    theta = fit(problem, start, budget=150, priors=True).theta
    rows = residuals.residuals(theta)
    m = int(broken.is_measured.sum())
    if rows[m:].any():
        return np.inf
    left = np.full(broken.coordinates.shape, np.nan)
    left[broken.is_measured] = rows[:m]
    return float(np.sqrt(np.nanmean(left**2, axis=0)).max() / sd)


def _coordinates(laxity: Laxity, columns: slice | list[int], factor: float) -> Laxity:
    values = np.array(laxity.coordinates)
    values[:, columns] *= factor
    return replace(laxity, coordinates=values, sd=None)


def _loads(laxity: Laxity, columns: slice | list[int], factor: float) -> Laxity:
    loads = np.array(laxity.protocol.loads)
    loads[:, columns] *= factor
    return _with_loads(laxity, loads)


def _with_loads(laxity: Laxity, loads: np.ndarray) -> Laxity:
    return replace(laxity, protocol=replace(laxity.protocol, loads=loads), sd=None)


def _scaled(names: Sequence[str], factor: float, what: str) -> Planted:
    """The named columns multiplied."""
    coordinates = [COORDINATES.index(x) for x in names if x in COORDINATES]
    loads = [LOADS.index(x) for x in names if x in LOADS]
    return Planted(
        broken=lambda x: _loads(_coordinates(x, coordinates, factor), loads, factor), what=what
    )


def _exchanged(one: str, other: str) -> Planted:
    names = list(COORDINATES if one in COORDINATES else LOADS)
    order = list(range(5))
    i, j = names.index(one), names.index(other)
    order[i], order[j] = j, i

    def broken(x: Laxity) -> Laxity:
        if one in LOADS:
            return _with_loads(x, x.protocol.loads[:, order])
        return replace(x, coordinates=x.coordinates[:, order], sd=None)

    return Planted(broken=broken, what=f"exchanging {one} and {other}")


def _translations(definition: Translations) -> Planted:
    def broken(x: Laxity) -> Laxity:
        moved = from_components(definition, x.protocol.flexion_deg, x.coordinates)
        return replace(x, coordinates=moved, sd=None)

    return Planted(broken=broken, what=f"(# translations: {definition})")


def _relative(laxity: Laxity) -> Laxity:
    return replace(relative_to_unloaded(laxity), sd=None, zero="absolute")


def _in_radians(laxity: Laxity) -> Laxity:
    protocol = laxity.protocol
    flexion = protocol.flexion_deg * np.pi / 180.0
    return replace(laxity, protocol=replace(protocol, flexion_deg=flexion), sd=None)


RADIAN = np.pi / 180.0
_UNITS = {
    "lengths in m": (LENGTHS, 0.001, "taking lengths for m "),
    "lengths in cm": (LENGTHS, 0.1, "taking lengths for cm"),
    "lengths in inches": (LENGTHS, 1.0 / 25.4, "taking lengths for inches"),
    "angles in radians": (ANGLES, RADIAN, "taking angles for radians"),
    "moments in N·mm": (LOADS[:2], 1000.0, "taking moments for N·mm"),
    "moments in N·cm": (LOADS[:2], 100.0, "taking moments for N·cm"),
    "moments in inch-pounds": (LOADS[:2], 8.85075, "taking moments for inch-pounds"),
    "forces in kN": (FORCES, 0.001, "taking forces for kN"),
    "forces in pounds": (FORCES, 1.0 / 4.44822, "taking forces for pounds"),
    "forces in kilograms": (FORCES, 1.0 / 9.80665, "taking forces for kilograms"),
    **{f"{x} in m": ((x,), 0.001, f"taking {x} for m") for x in LENGTHS},
    **{f"{x} in cm": ((x,), 0.1, f"taking {x} for cm") for x in LENGTHS},
    **{f"{x} in radians": ((x,), RADIAN, f"taking {x} for radians") for x in ANGLES},
}
_SIGNS = {
    "femur in tibia": (COORDINATES, "negating all coordinates"),
    "all lengths": (LENGTHS, "negating all lengths"),
    "both angles": (ANGLES, "negating both angles"),
    "all loads": (LOADS, "negating all loads"),
    "both moments": (LOADS[:2], "negating both moments"),
    **{x: ((x,), f"negating {x}") for x in (*COORDINATES, *LOADS[:3])},
}
_SIDES = {
    "coordinates and loads": [COORDINATES[i] for i in SIDED] + [LOADS[i] for i in SIDED_LOADS],
    "coordinates": [COORDINATES[i] for i in SIDED],
}
PLANTED: Mapping[str, Planted] = {
    **{f"{x} flipped": _scaled(names, -1.0, what) for x, (names, what) in _SIGNS.items()},
    **{
        f"{x} of the other side": _scaled(names, -1.0, f"taking {x} for those of the other side")
        for x, names in _SIDES.items()
    },
    **{title: _scaled(*how) for title, how in _UNITS.items()},
    "flexion in radians": Planted(broken=_in_radians, what="taking flexion_deg for radians"),
    **{
        f"{one} for {other}": _exchanged(one, other)
        for kind in (LENGTHS, ANGLES, LOADS[:2], ("anterior_force_N", "distraction_force_N"))
        for one, other in combinations(kind, 2)
    },
    "projections": _translations("projections"),
    "axes of the femur": _translations("femur"),
    "axes of the tibia": _translations("tibia"),
    "zeroed unloaded": Planted(
        broken=_relative, what="counting coordinates from the unloaded pose"
    ),
    "absolute called relative": Planted(
        broken=lambda x: replace(x, zero="unloaded", sd=None),
        what="taking coordinates for absolute ones",
    ),
}
