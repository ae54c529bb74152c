"""Broken conventions of tables, such as signs and units, that explain why a model does not fit."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import chdtrc, fdtrc

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import Problem, ProblemWithPriors, WhitenedResiduals
from identknee.checks.data_noise import STATED_SPREAD, UNITS, noise_of
from identknee.checks.table_checks import (
    IMPROBABLE,
    MOST_DEG,
    MOST_MM,
    load_sign_findings,
)
from identknee.checks.usable_trials import STRETCHES, TrialSearch, held_everywhere
from identknee.laxity.experiments import Cut, cuts_of, state_words
from identknee.laxity.protocol import (
    ABSOLUTE,
    FLEXION,
    LOADS,
    UNLOADED,
    Protocol,
    unloaded_trials,
)
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity, root_mean
from identknee.laxity.translations import COMPONENTS, DEFINITIONS, Translations, to_components
from identknee.model.effects.effect import Effect
from identknee.model.effects.library import library
from identknee.model.laxity_model import LaxityModel
from identknee.model.nuisances import Registration
from identknee.model.parameters import Parameters
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array, BoolArray, IntArray, declared, entry
from identknee.runs.findings import Finding, finding
from identknee.runs.words import capitalised

# Names of both kinds of columns, coordinates first.
COLUMNS = (*COORDINATES, *LOADS)
_LENGTHS = tuple(x for x in COORDINATES if x.endswith("_mm"))
_ANGLES = tuple(x for x in COORDINATES if x.endswith("_deg"))
_MOMENTS = tuple(x for x in LOADS if x.endswith("_Nm"))
_FORCES = tuple(x for x in LOADS if x.endswith("_N"))
# Columns whose sign changes between a left and a right knee.
_SIDED = ("lateral_shift_mm", "varus_deg", "internal_deg")
_SIDED_LOADS = ("internal_moment_Nm", "varus_moment_Nm", "lateral_force_N")
_UNITS = (
    (_LENGTHS, 1000.0, "m", "mm"),
    (_LENGTHS, 10.0, "cm", "mm"),
    (_LENGTHS, 25.4, "inches", "mm"),
    (_ANGLES, 180.0 / np.pi, "radians", "degrees"),
    (_MOMENTS, 0.001, "N·mm", "N·m"),
    (_MOMENTS, 0.01, "N·cm", "N·m"),
    (_MOMENTS, 0.112985, "inch-pounds", "N·m"),
    (_MOMENTS, 9.80665, "kgf·m", "N·m"),
    (_FORCES, 1000.0, "kN", "N"),
    (_FORCES, 4.44822, "pounds", "N"),
    (_FORCES, 9.80665, "kilograms", "N"),
)
# Standard deviation [mm, deg] below that of any instrument: a smaller one is in the wrong unit too.
LEAST_SD = 0.02
# Median of unloaded coordinates [mm, deg] below which the unloaded pose was probably set to zero.
ZEROED = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Convention:
    """A change of a laxity table that would put one broken convention right.

    Attributes
    ----------
    what
        The change in words, as the subject of a sentence.
    order
        For each of `COLUMNS` the column that its values are taken from, shape ``(10,)``.
    factors
        Factor of each column, shape ``(10,)``.
    flexion
        Factor of flexion.
    zero
        Zero of the coordinates, as in `Laxity`; None for that of the table.
    translations
        Definition by which translations were written; they are converted to components.
    states
        State of each trial; None for that of the table.
    """

    what: str
    order: tuple[int, ...] = tuple(range(len(COLUMNS)))
    factors: tuple[float, ...] = (1.0,) * len(COLUMNS)
    flexion: float = 1.0
    zero: str | None = None
    translations: Translations = COMPONENTS
    states: tuple[str, ...] | None = None

    def applied(self, laxity: Laxity) -> Laxity | None:
        """The changed table; None if it would be the same or is no valid table.

        If a unit changes, standard deviations keep their numbers, unless they are too small to be
        in the correct unit.
        """
        n = len(COORDINATES)
        order, factors = np.array(self.order), np.array(self.factors)
        protocol = laxity.protocol
        loads = protocol.loads[:, order[n:] - n] * factors[n:]
        coordinates = laxity.coordinates[:, order[:n]] * factors[:n]
        if self.translations != COMPONENTS:
            if laxity.zero != ABSOLUTE or not laxity.is_measured.all():
                return None
            coordinates = to_components(self.translations, protocol.flexion_deg, coordinates)
        zero = laxity.zero if self.zero is None else self.zero
        flexion = protocol.flexion_deg * self.flexion
        states = protocol.state if self.states is None else self.states
        # An exchange with a column that was not measured would move the blank cells.
        if np.any(np.isnan(coordinates) != np.isnan(laxity.coordinates)):
            return None
        sd = laxity.sd
        if sd is not None:
            own = sd[:, order[:n]]
            sd = np.where(own < LEAST_SD, np.abs(factors[:n]) * own, own)
        try:
            changed = replace(
                laxity,
                protocol=replace(protocol, flexion_deg=flexion, loads=loads, state=states),
                coordinates=coordinates,
                sd=sd,
                zero=zero,
            )
        except ValueError:
            return None
        return None if _is_same(changed, laxity) else changed


def conventions_of(laxity: Laxity, structures: Sequence[str] = ()) -> tuple[Convention, ...]:
    """Changes of a table that would correct common mistakes.

    They concern signs of columns, of motions and of loads, units, the other side of the body,
    exchanged columns, definitions of translations, the zero of coordinates, and, in a table with
    ligaments cut, states of the knee.

    Parameters
    ----------
    laxity
        The table.
    structures
        Ligaments and groups of the knee that may have been cut.
    """
    return (
        *_of_columns(),
        *_of_translations(),
        *_zeros(laxity),
        *_of_states(laxity.protocol, structures),
    )


def _of_columns() -> Iterator[Convention]:
    """Signs, sides, units and exchanges."""
    for name in COLUMNS:
        yield Convention(what=f"negating {name}", factors=_negated((name,)))
    yield Convention(
        what="negating all coordinates (motion of the femur in the tibia)",
        factors=_negated(COORDINATES),
    )
    yield Convention(what="negating all lengths", factors=_negated(_LENGTHS))
    yield Convention(what="negating both angles", factors=_negated(_ANGLES))
    yield Convention(what="negating all loads (loads on the femur)", factors=_negated(LOADS))
    yield Convention(what="negating both moments", factors=_negated(_MOMENTS))
    yield Convention(what=f"negating {FLEXION}", flexion=-1.0)
    for what, names in (
        ("coordinates and loads", (*_SIDED, *_SIDED_LOADS)),
        ("coordinates", _SIDED),
        ("loads", _SIDED_LOADS),
    ):
        said = f"taking {what} for those of the other side (left for right)"
        yield Convention(what=said, factors=_negated(names))
    kinds = {_LENGTHS: "lengths", _ANGLES: "angles", _MOMENTS: "moments", _FORCES: "forces"}
    for columns, factor, unit, wanted in _UNITS:
        said = f"taking {kinds[columns]} for {unit} and converting them to {wanted}"
        yield Convention(what=said, factors=_scaled(columns, factor))
    for columns, factor, unit, _ in _UNITS:
        for name in columns:
            yield Convention(what=f"taking {name} for {unit}", factors=_scaled((name,), factor))
    yield Convention(what=f"taking {FLEXION} for radians", flexion=180.0 / np.pi)
    for kind in (_LENGTHS, _ANGLES, _MOMENTS, _FORCES):
        for one, other in combinations(kind, 2):
            order = list(range(len(COLUMNS)))
            i, j = COLUMNS.index(one), COLUMNS.index(other)
            order[i], order[j] = j, i
            yield Convention(what=f"exchanging {one} and {other}", order=tuple(order))


def _of_translations() -> Iterator[Convention]:
    """Other definitions of translations."""
    names = {
        "projections": "projections on the axes of Grood and Suntay",
        "femur": "translations along the axes of the femur",
        "tibia": "translations along the axes of the tibia",
    }
    for definition in DEFINITIONS:
        if definition != COMPONENTS:
            what = f"reading translations as {names[definition]} (# translations: {definition})"
            yield Convention(what=what, translations=definition)


def _zeros(laxity: Laxity) -> Iterator[Convention]:
    if laxity.zero == UNLOADED:
        yield Convention(
            what="taking coordinates for absolute ones (without zero: unloaded)", zero=ABSOLUTE
        )
        return
    if laxity.zero != ABSOLUTE:
        return
    unloaded = laxity.coordinates[laxity.protocol.is_unloaded]
    known = np.abs(unloaded[~np.isnan(unloaded)])
    if not known.size or np.median(known) > ZEROED:
        return
    try:
        unloaded_trials(laxity.protocol)
    except ValueError:
        return
    yield Convention(
        what="counting coordinates from the unloaded pose of each flexion angle (zero: unloaded)",
        zero=UNLOADED,
    )


def _of_states(protocol: Protocol, structures: Sequence[str]) -> Iterator[Convention]:
    """Changes of states: a cut that was not made, another structure cut, and two states exchanged.

    States with partial cuts are left out, because the fraction that is cut is estimated anyway.
    """
    if protocol.state is None:
        return
    series, states = protocol.series, protocol.state
    first = np.unique(series, return_index=True)[1].tolist()
    labels = [states[i] for i in first]
    whole = [k for k, label in enumerate(labels) if not any(x.is_partial for x in cuts_of(label))]

    def said(k: int) -> str:
        of = "" if protocol.experiment is None else f" of {protocol.experiment[first[k]]}"
        return f'"{labels[k]}"{of if labels.count(labels[k]) > 1 else ""}'

    for k in whole:
        for state in _other_states(cuts_of(labels[k]), structures):
            yield Convention(
                what=f'taking the trials of the state {said(k)} for "{state}"',
                states=_relabelled(states, series, {k: state}),
            )
    for j, k in combinations(whole, 2):
        if labels[j] != labels[k]:
            yield Convention(
                what=f"exchanging the states {said(j)} and {said(k)}",
                states=_relabelled(states, series, {j: labels[k], k: labels[j]}),
            )


def _other_states(cuts: Sequence[Cut], structures: Sequence[str]) -> Iterator[str]:
    """States with one cut not made, or made in another structure."""
    taken = {x.ligament for x in cuts}
    for x in cuts:
        rest = [y for y in cuts if y is not x]
        yield state_words(rest)
        for other in structures:
            made = [*rest, Cut(ligament=other, fraction=1.0)]
            if other not in taken and {y.ligament for y in made} != set(structures):
                yield state_words(made)


def _relabelled(
    states: Sequence[str], series: IntArray, labels: Mapping[int, str]
) -> tuple[str, ...]:
    return tuple(labels.get(int(k), x) for k, x in zip(series, states, strict=True))


def _negated(names: Sequence[str]) -> tuple[float, ...]:
    return _scaled(names, -1.0)


def _scaled(names: Sequence[str], factor: float) -> tuple[float, ...]:
    return tuple(factor if x in names else 1.0 for x in COLUMNS)


# Share of the misfit that a change must remove to be named, and largest share that it may leave by
# the linear model to be fitted.
REMOVED, PROMISED = 0.9, 0.6
MOST_FITS = 6
BUDGET = 80
# Share of the measured trials that may have no equilibrium in the changed table.
MOST_LOST = 0.2
# Times the misfit of the best change up to which another change is as good.
AS_GOOD = 1.5
# Least fall of the misfit, as a factor, where no noise is known.
FALL = 2.0
# Times the misfit of a change up to which the linear model of a rival is worth a fit.
LIKELY = 3.0
MOST_CAUSES = 3
# Standard deviations of the measured frames around those of the geometry, as a rival cause.
FRAMES_DEG, FRAMES_MM = 5.0, 5.0
# Least standard deviation of any instrument [mm, deg].
LEAST_NOISE = 0.02
# Degrees of freedom of a stated noise, which is taken to be right to 20 %.
STATED_DEGREES = 0.5 / STATED_SPREAD**2


@declared
class BrokenConvention:
    """A change of the table that removes nearly all of the misfit, and leaves a plausible one."""

    what: str = entry("The change of the table that puts it right")
    removed: float = entry("Share of the misfit that it removes", unit="1")
    mm_before: float = entry("Error of the lengths in the table as it is", unit="mm")
    deg_before: float = entry("Error of the angles in the table as it is", unit="deg")
    mm_after: float = entry("Error of the lengths in the table put right", unit="mm")
    deg_after: float = entry("Error of the angles in the table put right", unit="deg")
    others: tuple[str, ...] = entry("Other changes that do as well")

    @property
    def sentence(self) -> str:
        """What was found and what to do."""
        sizes = ((self.mm_before, self.mm_after, "mm"), (self.deg_before, self.deg_after, "deg"))
        known = [x for x in sizes if np.isfinite(x[0]) and np.isfinite(x[1])]
        falls = " and ".join(f"from {a:.3g} to {b:.3g} {unit}" for a, b, unit in known)
        also = f" So does {' or '.join(self.others)}." if self.others else ""
        return (
            f"{capitalised(self.what)} removes {min(100.0 * self.removed, 99.0):.0f} % of the "
            f"misfit (the error falls {falls}), and what is left is plausible: the table violates "
            f"this convention, and no fit to it is valid.{also} Correct the table and repeat the "
            "command."
        )

    @property
    def finding(self) -> Finding:
        """The finding of this change."""
        values = {
            "what": self.what,
            "removed_share": self.removed,
            "before_mm": self.mm_before,
            "after_mm": self.mm_after,
            "before_deg": self.deg_before,
            "after_deg": self.deg_after,
            "others": self.others,
        }
        return finding("broken-convention", "data", values, sentence=self.sentence)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Noise:
    """Standard deviations (n, 5) with degrees of freedom; not known if taken from residuals."""

    sd: Array
    degrees: float
    is_known: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PutRight:
    """A fit to a changed table, compared with the fit to the table as it is."""

    convention: Convention
    table: "_Table"
    theta: Array
    noise: _Noise
    used: BoolArray
    n_gained: int
    before: float
    after: float
    score: float

    @property
    def removed(self) -> float:
        """Share of the misfit that it removes: of that beyond the noise, where this is known."""
        return self._removed(self.after)

    @property
    def p_value(self) -> float:
        """Probability that chance alone makes the misfit fall so far."""
        degrees = self.table.degrees(self.used)
        fall = max(self.before - self.after, 0.0) / max(1.0, self.after / degrees)
        return float(fdtrc(1.0, min(self.noise.degrees, 1e9), fall))

    def is_named(self, n_tried: int) -> bool:
        """Whether the change explains the misfit, as one of `n_tried` changes."""
        measured = self.table.measured.any(axis=1)
        is_lost = self.n_gained < 0 or (measured & ~self.used).sum() > MOST_LOST * measured.sum()
        is_chance = self.p_value * n_tried >= IMPROBABLE
        return not is_lost and not is_chance and self.explains(self.after)

    def explains(self, square: float) -> bool:
        """Whether a misfit of `square` is plausible and nearly all of that before is removed."""
        if not self.noise.is_known:
            mm, deg = self.table.errors(self.theta)
            is_small = not mm > MOST_MM and not deg > MOST_DEG
            return is_small and square <= AS_GOOD * self.after and self.before >= FALL * square
        chance = self.table.chance(square, self.used, min(self.noise.degrees, STATED_DEGREES))
        return self._removed(square) >= REMOVED and chance >= IMPROBABLE

    def _removed(self, square: float) -> float:
        # A noise that was taken from what is left would say that all else is removed.
        noise = min(square, float(self.table.degrees(self.used))) if self.noise.is_known else 0.0
        return (self.before - square) / (self.before - noise) if self.before > square else 0.0


# Results remembered of each table.
MOST_REMEMBERED = 4


class _Remembered:
    """A problem that remembers its last few residuals and Jacobians."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._known: dict[tuple[str, bytes], Array] = {}

    @property
    def parameters(self) -> Parameters:
        return self._problem.parameters

    def residuals(self, theta: Array) -> Array:
        return self._asked("residuals", self._problem.residuals, theta)

    def jacobian(self, theta: Array) -> Array:
        return self._asked("jacobian", self._problem.jacobian, theta)

    def _asked(self, what: str, asked: Callable[[Array], Array], theta: Array) -> Array:
        place = what, theta.tobytes()
        if place not in self._known:
            if len(self._known) == MOST_REMEMBERED:
                del self._known[next(iter(self._known))]
            self._known[place] = asked(theta)
        return self._known[place]


class _Table:
    """A table and a model: the residuals in mm and deg, and in units of the noise.

    A trial without equilibrium is held near its measured pose, and its residuals are larger than
    those of any equilibrium.
    """

    def __init__(
        self, model: LaxityModel, laxity: Laxity, states: tuple[str, ...] | None = None
    ) -> None:
        # Noise is estimated with the original states: relabelled trials are no replicates.
        self.states = laxity.protocol.state if states is None else states
        if laxity.sd is not None and np.isnan(laxity.sd[laxity.is_measured]).any():
            laxity = replace(laxity, sd=None)
        self.laxity = laxity
        self.residuals = held_everywhere(LaxityResiduals(model=model, laxity=laxity))
        self._remembered = _Remembered(self.residuals)
        self.measured = laxity.is_measured
        self.n_asked = int(self.residuals.parameters.is_of_interest.sum())

    @property
    def model(self) -> LaxityModel:
        return self.residuals.model

    def left(self, theta: Array) -> tuple[Array, Array]:
        """Measured less predicted (n, 5), NaN where not measured, and the lack of trials (n,).

        The lack is 0 where a trial has an equilibrium; see `HeldTrials`.
        """
        rows = self._remembered.residuals(theta)
        found = np.full(self.measured.shape, np.nan)
        m = int(self.measured.sum())
        found[self.measured] = -rows[:m]
        return found, rows[m:]

    @property
    def n_cuts(self) -> int:
        """Number of cuts in the states of all trials."""
        return sum(len(cuts_of(x)) for x in self.laxity.protocol.state or ())

    def square(self, theta: Array, sd: Array, used: BoolArray | None = None) -> float:
        """Sum of squared residuals in units of the noise, over the trials `used`."""
        left, lack = self.left(theta)
        by_trial = np.nansum((left / sd) ** 2, axis=1) + (lack / np.nanmin(sd)) ** 2
        return float(by_trial.sum() if used is None else by_trial[used].sum())

    def degrees(self, used: BoolArray) -> int:
        """Degrees of freedom of the residuals of the trials `used`."""
        return max(int(self.measured[used].sum()) - self.n_asked, 1)

    def has_equilibrium(self, theta: Array) -> BoolArray:
        """Which measured trials have an equilibrium."""
        return np.asarray(self.measured.any(axis=1) & (self.left(theta)[1] == 0.0))

    def noise_at(self, theta: Array) -> _Noise:
        """The noise that the data show or state; else the residuals, in mm and in deg."""
        left, lack = self.left(theta)
        used = np.asarray(lack == 0.0)
        seen = replace(
            self.laxity,
            protocol=replace(self.laxity.protocol, state=self.states),
            coordinates=np.where(used[:, None], self.laxity.coordinates, np.nan),
        )
        found = noise_of(seen, left) if used.any() else None
        if found is not None:
            sd = np.maximum(found.sd, LEAST_NOISE)
            for columns in UNITS.values():
                known = sd[:, columns]
                if np.isfinite(known).any():
                    known[np.isnan(known)] = np.nanmedian(known)
            degrees = found.degrees_of_freedom
            return _Noise(sd=np.where(self.measured, sd, np.nan), degrees=degrees)
        share = np.sqrt(self.degrees(used) / max(int(self.measured[used].sum()), 1))
        sd = np.full(self.measured.shape, np.nan)
        for columns in UNITS.values():
            size = root_mean(left[used][:, columns] ** 2)
            sd[:, columns] = max(size / share, LEAST_NOISE) if np.isfinite(size) else 1.0
        sd = np.where(self.measured, sd, np.nan)
        return _Noise(sd=sd, degrees=float(self.degrees(used)), is_known=False)

    def is_noise(self, theta: Array) -> bool:
        """Whether a known noise, or rounding, explains the residuals."""
        if (
            not any(x > LEAST_NOISE for x in self.errors(theta))
            and self.has_equilibrium(theta)[self.measured.any(axis=1)].all()
        ):
            return True
        noise = self.noise_at(theta)
        if not noise.is_known or not self.has_equilibrium(theta).any():
            return False
        used = np.asarray(self.measured.any(axis=1))
        return self.chance(self.square(theta, noise.sd), used, noise.degrees) >= IMPROBABLE

    def chance(self, square: float, used: BoolArray, degrees: float) -> float:
        """P-value of a misfit, with a noise estimated from so many degrees of freedom."""
        own = self.degrees(used)
        if np.isinf(degrees):
            return float(chdtrc(own, square))
        return float(fdtrc(own, degrees, square / own))

    def errors(self, theta: Array) -> tuple[float, float]:
        """Root-mean-square residuals [mm, deg]; NaN where nothing was measured."""
        left, _ = self.left(theta)
        return root_mean(left[:, TRANSLATIONS] ** 2), root_mean(left[:, ROTATIONS] ** 2)

    def problem(self, noise: _Noise) -> WhitenedResiduals:
        """The residuals in units of the noise."""
        return WhitenedResiduals(problem=self.residuals, sd=self._sd(noise))

    def _sd(self, noise: _Noise) -> Array:
        rows = noise.sd[self.measured], np.full(self.laxity.n, np.nanmin(noise.sd))
        return np.concatenate(rows)

    def searched(self, start: Array) -> Array:
        """Fitted parameters as of `fitted`, also if trials have no equilibrium at the start."""
        if not self.has_equilibrium(start)[self.measured.any(axis=1)].all():
            start = self.search.used(start).start
        return self.fitted(start, self.noise_at(start))

    def fitted(self, start: Array, noise: _Noise) -> Array:
        """Parameters fitted to it with their priors, shape ``(p,)``."""
        return fit(self.problem(noise), start, budget=BUDGET, priors=True).theta

    def beginnings(self, *starts: Array) -> Iterator[Array]:
        """The given starts, and one with ligaments stretched at the table's measured poses."""
        yield from starts
        if self.model.poses is not None:
            yield self.search.stretched(starts[0], STRETCHES[-1])

    @property
    def search(self) -> TrialSearch:
        """Search for trials with an equilibrium, without limits, which would need a noise."""
        search = TrialSearch(model=self.model, laxity=self.laxity, weighting="unit", bounds={})
        return search.without_limits

    def linearised(self, start: Array, noise: _Noise) -> tuple[float, Array]:
        """Least misfit of the model linearised at `start`, with its priors, and theta there.

        Trials without equilibrium count as the mean of the others; infinite if most have none.
        """
        whitened = WhitenedResiduals(problem=self._remembered, sd=self._sd(noise))
        problem = ProblemWithPriors(problem=whitened)
        parameters = problem.parameters
        rows = problem.residuals(start)
        if not np.isfinite(rows).all():
            return np.inf, start
        # In working coordinates, in which priors are normal.
        slopes = (
            problem.jacobian(start) * np.where(parameters.is_log, start, 1.0) * parameters.prior_sd
        )
        step = np.linalg.lstsq(slopes, -rows, rcond=None)[0]
        used, m = self.has_equilibrium(start), int(self.measured.sum())
        left = (rows + slopes @ step)[:m][used[np.nonzero(self.measured)[0]]]
        working = parameters.to_working(start) + parameters.prior_sd * step
        reached = parameters.from_working(working)
        square = m * float(np.mean(left**2)) if 2 * left.size > m else np.inf
        return square, np.clip(reached, parameters.lower, parameters.upper)


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A changed table, where a fit to it begins, and the misfit that the linear model predicts."""

    convention: Convention
    table: _Table
    noise: _Noise
    begin: Array
    promised: float


def find_broken_convention(
    model: LaxityModel, laxity: Laxity, start: Array, fitted: Array | None = None
) -> BrokenConvention | None:
    """The convention that explains why a model does not fit a table; None if there is none.

    There is no search if the misfit is explained by the noise that the data show or, if they show
    none, that they state. All changes of the table are compared by the linear model with the priors
    of the parameters, and the few with the lowest predicted misfit are fitted. One is named if it
    removes nearly all of the misfit, significantly so among all changes, if the remaining misfit is
    plausible, and if no physical cause removes as much.

    Parameters
    ----------
    model, laxity
        The model and the data.
    start
        Theta where fits begin, shape ``(p,)``.
    fitted
        Parameters fitted to the table as it is, shape ``(p,)``; if None they are fitted here.
    """
    parameters = model.parameters
    if np.any(parameters.is_log & ~(parameters.center > 0.0)):
        # A stiffness of zero has no lognormal prior.
        return None
    as_is = _Table(model, laxity)
    theta = as_is.searched(start) if fitted is None else fitted
    if as_is.is_noise(theta):
        return None
    candidates, n_tried = _promising(as_is, start, theta)
    found: list[_PutRight] = []
    for candidate in candidates:
        # Candidates are sorted by promise: the rest are unlikely to come near the best fit.
        if found and candidate.promised > LIKELY * min(x.score for x in found):
            break
        put_right = _compared(as_is, theta, candidate, n_tried)
        if put_right is not None:
            found.append(put_right)
    if not found:
        return None
    lowest = min(x.score for x in found)
    # Among equally good changes the fewest cuts win: a structure that carries nothing in the trials
    # may be cut or not.
    alike = [x for x in found if x.score <= AS_GOOD * lowest]
    best = min(alike, key=lambda x: (x.table.n_cuts, x.score))
    if _has_physical_rival(as_is, theta, best):
        return None
    before_mm, before_deg = as_is.errors(theta)
    mm_after, deg_after = best.table.errors(best.theta)
    return BrokenConvention(
        what=best.convention.what,
        removed=best.removed,
        mm_before=before_mm,
        deg_before=before_deg,
        mm_after=mm_after,
        deg_after=deg_after,
        others=tuple(
            x.convention.what for x in found if x is not best and x.score <= AS_GOOD * best.score
        ),
    )


def _promising(as_is: _Table, start: Array, theta: Array) -> tuple[list[_Candidate], int]:
    """The changes worth a fit, the most promising first, and the number of changes compared."""
    found: list[_Candidate] = []
    seen: list[Laxity] = []
    # Loads read in another unit may have driven the start to where trials have an equilibrium.
    own = as_is.model.parameters.center
    begins = (start, theta) if np.array_equal(own, start) else (start, own, theta)
    for convention in conventions_of(as_is.laxity, as_is.model.tied.names):
        changed = convention.applied(as_is.laxity)
        if changed is None or any(_is_same(changed, x) for x in seen):
            continue
        seen.append(changed)
        table = _Table(as_is.model, changed, as_is.states)
        noise = table.noise_at(start)
        if not noise.is_known:
            noise = replace(noise, sd=np.where(table.measured, 1.0, np.nan))
        linear = [(table.linearised(x, noise)[0], x) for x in table.beginnings(*begins)]
        promised, begin = min(linear, key=lambda x: x[0])
        here = min(as_is.square(theta, noise.sd), as_is.linearised(theta, noise)[0])
        if promised <= PROMISED * here:
            found.append(_Candidate(convention, table, noise, begin, promised))
    return sorted(found, key=lambda x: x.promised)[:MOST_FITS], len(seen)


def _is_same(one: Laxity, other: Laxity) -> bool:
    return (
        one.zero == other.zero
        and np.array_equal(one.coordinates, other.coordinates, equal_nan=True)
        and np.array_equal(one.protocol.loads, other.protocol.loads)
        and np.array_equal(one.protocol.flexion_deg, other.protocol.flexion_deg)
        and one.protocol.state == other.protocol.state
    )


def _compared(as_is: _Table, theta: Array, candidate: _Candidate, n_tried: int) -> _PutRight | None:
    """The fit to the changed table; None if the change does not explain the misfit."""
    table = candidate.table
    found = _put_right(candidate, as_is, theta, table.fitted(candidate.begin, candidate.noise))
    if not found.is_named(n_tried):
        return None
    # The noise is estimated better from a model that fits, so both tables are fitted once more.
    found = _put_right(candidate, as_is, theta, table.fitted(found.theta, found.noise))
    refitted = as_is.square(as_is.fitted(theta, found.noise), found.noise.sd, found.used)
    found = replace(found, before=min(found.before, refitted))
    return found if found.is_named(n_tried) else None


def _put_right(candidate: _Candidate, as_is: _Table, theta: Array, end: Array) -> _PutRight:
    """Comparison of `end`, fitted to the changed table, with `theta`, fitted to it as it is."""
    table = candidate.table
    noise, used = table.noise_at(end), table.has_equilibrium(end)
    return _PutRight(
        convention=candidate.convention,
        table=table,
        theta=end,
        noise=noise,
        used=used,
        n_gained=int(used.sum() - as_is.has_equilibrium(theta).sum()),
        before=as_is.square(theta, noise.sd, used),
        after=table.square(end, noise.sd, used),
        score=table.square(end, candidate.noise.sd, used),
    )


def _has_physical_rival(as_is: _Table, theta: Array, best: _PutRight) -> bool:
    """Whether a physical cause explains the table as it is equally well."""
    laxity, base = as_is.laxity, as_is.model
    causes: list[Effect] = [Registration(sd_deg=FRAMES_DEG, sd_mm=FRAMES_MM)]
    with suppress(ValueError):
        causes += library(
            base.knee, has_order=laxity.order is not None, has_phase=laxity.phase is not None
        )
    known = {x.name for x in base.effects}
    tried = []
    for cause in causes:
        if cause.name in known:
            continue
        table = _Table(base.with_effects([*base.effects, cause]), laxity)
        begin = np.r_[theta, cause.parameters.start]
        promised, reached = table.linearised(begin, best.noise)
        if promised <= LIKELY * best.after:
            tried.append((promised, table, reached))
    tried.sort(key=lambda x: x[0])
    for _, table, reached in tried[:MOST_CAUSES]:
        end = table.fitted(reached, best.noise)
        if best.explains(table.square(end, best.noise.sd, best.used)):
            return True
    return False


def convention_findings(
    model: LaxityModel, laxity: Laxity, start: Array, fitted: Array | None = None
) -> tuple[Finding, ...]:
    """A finding if a convention is broken.

    If the model shows none, as for a knee without equilibrium at the start, the table alone is
    checked for motion against the load.
    """
    found = find_broken_convention(model, laxity, start, fitted)
    return load_sign_findings(laxity) if found is None else (found.finding,)
