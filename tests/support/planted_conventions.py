"""Laxity tables with one convention broken on purpose, and what should name it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import WhitenedResiduals
from identknee.checks.broken_convention import BrokenConvention, find_broken_convention
from identknee.checks.usable_trials import TrialSearch, defined_everywhere, table_model
from identknee.laxity.protocol import LOADS, Protocol, concatenate, load_protocol
from identknee.laxity.table import (
    COORDINATES,
    ROTATIONS,
    TRANSLATIONS,
    Laxity,
    add_noise,
    example_laxity,
    relative_to_unloaded,
)
from identknee.laxity.translations import Translations, from_components
from identknee.model.effects.effect import Effect
from identknee.model.effects.library import library
from identknee.model.laxity_model import LaxityModel
from identknee.model.nuisances import Registration, load_axes
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array
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
    alike: str = ""

    def is_named(self, found: BrokenConvention | None) -> bool:
        """Whether it, or what only stray loads tell from it, is named and nothing else beside."""
        if found is None:
            return False
        said, right = (found.what, *found.others), (self.what, self.alike or self.what)
        return all(any(x in y for x in right) for y in said)


@dataclass(frozen=True, kw_only=True)
class DrawnTable:
    """A table drawn from a knee whose truth is known.

    Attributes
    ----------
    model
        The subject's model, which lacks whatever the truth has beside it.
    truth
        Parameters of that model in the truth, shape ``(p,)``.
    exact, laxity
        Without noise, and with it, unstated.
    noise
        Its standard deviation [mm, deg].
    cause
        What the truth has and the model lacks; empty for nothing.
    """

    model: LaxityModel
    truth: Array
    exact: Laxity
    laxity: Laxity
    noise: float
    cause: str = ""


def clean_table(
    name: str, seed: int, *, noise: float = NOISE, protocol: Protocol | None = None
) -> tuple[LaxityModel, Laxity]:
    """A knee, and the laxity of one like it under rotations and drawers, with noise.

    Its stiffnesses differ from the subject's by 20 % and its reference strains by 1 % of strain.
    """
    used = rotations_and_drawers() if protocol is None else protocol
    model = LaxityModel(knee=example(name), protocol=used)
    _, made = _drawn(model, model.parameters.center, np.random.default_rng(seed))
    return model, add_noise(made, sd_mm=noise, sd_deg=noise, seed=seed)


def rotations_and_drawers() -> Protocol:
    """69 trials on load curves of up to eleven points."""
    return concatenate([load_protocol("seed63"), load_protocol("drawer")], name="both")


def drawn_table(
    name: str, seed: int, *, is_wrong: bool = False, has_curves: bool = True
) -> DrawnTable:
    """A table of unstated noise; with `is_wrong`, of a knee or rig that the model is wrong about.

    One structure that the model lacks, wrong frames or load axes or another cause of the library,
    one after the other with the seed, up to three of its prior standard deviations. Tables of
    s192803 have the loads and angles of its measured one.
    """
    generator = np.random.default_rng([seed, sum(map(ord, name))])
    noise = (0.3, 0.5, 0.8)[seed % 3]
    base, center = _measured_knee() if name == "s192803" else _nominal_knee(name, has_curves)
    causes: tuple[Effect, ...] = (
        Registration(sd_deg=3.0, sd_mm=3.0),
        load_axes(4.0),
        *library(base.knee),
    )
    cause = causes[seed % len(causes)]
    model, n = base, base.parameters.n
    if is_wrong:
        model = base.with_effects([*base.effects, cause])
        center = np.r_[center, cause.parameters.center]
    theta, made = _drawn(model, center, generator, least=0.8 if name == "s192803" else 1.0)
    laxity = add_noise(made, sd_mm=noise, sd_deg=noise, seed=seed)
    return DrawnTable(
        model=base,
        truth=theta[:n],
        exact=made,
        laxity=replace(laxity, sd=None),
        noise=noise,
        cause=cause.name if is_wrong else "",
    )


def _nominal_knee(name: str, has_curves: bool) -> tuple[LaxityModel, Array]:
    protocol = rotations_and_drawers()
    if not has_curves:
        largest = np.abs(protocol.loads).max(axis=1)
        protocol = protocol.select(np.flatnonzero((largest == 0.0) | (largest >= 10.0)))
    model = LaxityModel(knee=example(name), protocol=protocol)
    return model, model.parameters.center


@lru_cache(maxsize=1)
def _measured_knee() -> tuple[LaxityModel, Array]:
    """S192803, and its parameters as they follow from its measured table."""
    knee, laxity = example("s192803"), example_laxity("s192803")
    model, _ = table_model(knee, laxity)
    search = TrialSearch(model=model, laxity=laxity, weighting="unit", bounds={})
    used = search.used(model.parameters.start)
    return model, fit(search.problem(used.laxity), used.start).theta


def _drawn(
    model: LaxityModel, center: Array, generator: np.random.Generator, *, least: float = 1.0
) -> tuple[Array, Laxity]:
    """Parameters near `center` and their laxity, a share `least` of the trials stable."""
    own = model.parameters
    is_effect = np.arange(own.n) >= model.n_ligament_parameters
    while True:
        draws = generator.standard_normal(own.n)
        theta = np.where(own.is_log, center * np.exp(0.2 * draws), center + draws)
        # Of one sign where a cause has but one.
        sized = np.where(own.lower >= own.center, np.abs(draws), draws)
        theta = np.where(is_effect, own.center + 1.5 * own.prior_sd * sized, theta)
        theta = np.clip(theta, own.lower, own.upper)
        made = model.simulate(theta)
        stable = np.flatnonzero(made.is_measured.all(axis=1))
        if len(stable) == made.n:
            return theta, made
        if len(stable) >= least * made.n:
            return theta, made.select(stable)


def moved_by(drawn: DrawnTable, planted: Planted) -> float:
    """How far a broken convention moves a table, in units of the noise.

    The root-mean-square of what is left of the worst coordinate once ligaments, frames and load
    axes were fitted to the table without noise. Infinite where trials have no equilibrium then.
    """
    broken = planted.broken(drawn.exact)
    knee = drawn.model.knee.with_uncertainty(FRAMES)
    extended = LaxityModel(knee=knee, protocol=broken.protocol).with_tests(broken)
    residuals = defined_everywhere(LaxityResiduals(model=extended, laxity=broken))
    m = int(broken.is_measured.sum())
    problem = WhitenedResiduals(problem=residuals, sd=np.full(m + broken.n, drawn.noise))
    start = np.r_[drawn.truth, extended.parameters.center[len(drawn.truth) :]]
    rows = residuals.residuals(fit(problem, start, budget=60, priors=True).theta)
    if rows[m:].any():
        return np.inf
    left = np.full(broken.coordinates.shape, np.nan)
    left[broken.is_measured] = rows[:m]
    return float(np.sqrt(np.nanmean(left**2, axis=0)).max() / drawn.noise)


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
    **{x: ((x,), f"negating {x}") for x in (*COORDINATES, *LOADS[:3])},
}
_SIDES = {
    "coordinates and loads": [COORDINATES[i] for i in SIDED] + [LOADS[i] for i in SIDED_LOADS],
    "coordinates": [COORDINATES[i] for i in SIDED],
}
PLANTED: Mapping[str, Planted] = {
    **{f"{x} flipped": _scaled(names, -1.0, what) for x, (names, what) in _SIGNS.items()},
    "both moments flipped": replace(
        _scaled(LOADS[:2], -1.0, "negating both moments"), alike="taking loads for those of"
    ),
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


def convention_outcome(task: tuple[str, str, int, Sequence[str]]) -> dict[str, Any]:
    """Of a table drawn with this seed, planted or sound: what is said of its conventions.

    Each place of the last entry, all knees in their order, goes through all conventions.
    """
    kind, knee, seed, knees = task
    return _planted_outcome(knee, seed, knees) if kind == "planted" else _sound_outcome(knee, seed)


def _planted_outcome(knee: str, seed: int, knees: Sequence[str]) -> dict[str, Any]:
    """A planted convention: how far it moves the table, and whether it is named."""
    # Each place of the knees goes through all conventions, in steps that do not meet.
    turn, place = divmod(seed, len(knees))
    title = list(PLANTED)[(turn + 9 * place) % len(PLANTED)]
    planted, drawn = PLANTED[title], drawn_table(knee, seed)
    try:
        broken, moved = planted.broken(drawn.laxity), moved_by(drawn, planted)
    except ValueError:
        # No file of the kind would be read.
        return {"title": title, "moved": None, "is_named": False, "said": "refused"}
    model, _ = table_model(drawn.model.knee, broken)
    found = find_broken_convention(model, broken, model.parameters.start)
    said = "nothing" if found is None else " or ".join((found.what, *found.others))
    return {
        "title": f"{title}, seed {seed}",
        "moved": min(moved, 1e9),
        "is_named": planted.is_named(found),
        "said": said,
    }


def _sound_outcome(knee: str, seed: int) -> dict[str, Any]:
    """A sound table, every other one of a knee that the model is wrong about."""
    drawn = drawn_table(knee, seed, is_wrong=seed % 2 == 1, has_curves=seed % 4 < 2)
    model, _ = table_model(drawn.model.knee, drawn.laxity)
    found = find_broken_convention(model, drawn.laxity, model.parameters.start)
    return {
        "title": f"{drawn.cause or 'nothing wrong'}, seed {seed}",
        "is_accused": found is not None,
        "said": "" if found is None else found.what,
    }
