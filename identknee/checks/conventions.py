"""Conventions that a laxity table may break, and which of them a table does break."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import chdtrc

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import WhitenedResiduals
from identknee.checks.data_checks import load_sign_findings
from identknee.checks.fit_warnings import GROSS, IMPROBABLE, MOST_DEG, MOST_MM
from identknee.laxity.protocol import FLEXION, LOADS, unloaded_trials
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding, finding

# Names of both kinds of columns, coordinates first.
COLUMNS = (*COORDINATES, *LOADS)
_LENGTHS = tuple(x for x in COORDINATES if x.endswith("_mm"))
_ANGLES = tuple(x for x in COORDINATES if x.endswith("_deg"))
_MOMENTS = tuple(x for x in LOADS if x.endswith("_Nm"))
_FORCES = tuple(x for x in LOADS if x.endswith("_N"))
# Lateral and medial, varus and valgus, internal and external change places on the other side.
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
    (_FORCES, 1000.0, "kN", "N"),
    (_FORCES, 4.44822, "pounds", "N"),
    (_FORCES, 9.80665, "kilograms", "N"),
)
# A smaller standard deviation than any instrument's must be in the unit that is to be changed.
LEAST_SD = 0.02
# Poses of unloaded trials closer to zero than this [mm, deg] were set to zero.
ZEROED = 1.0
# Share of the misfit that a convention has to remove, and share of it that a straight model at the
# start has to promise before a fit is made.
REMOVED, PROMISED = 0.9, 0.5
MOST_FITS, BUDGET = 4, 80
# Of the measured trials, those with an equilibrium at the start.
LEAST_SHARE = 0.5
# Another convention that leaves no more than so many times the misfit is as good.
AS_GOOD = 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Convention:
    """A change of a laxity table that would put one broken convention right.

    Attributes
    ----------
    what
        What it does, as the subject of a sentence.
    order
        Which of `COLUMNS` each column takes its values from, shape ``(10,)``.
    factors
        What they are multiplied by, shape ``(10,)``.
    flexion
        What flexion is multiplied by.
    zero
        What coordinates are counted from; None for what the table says.
    """

    what: str
    order: tuple[int, ...] = tuple(range(len(COLUMNS)))
    factors: tuple[float, ...] = (1.0,) * len(COLUMNS)
    flexion: float = 1.0
    zero: str | None = None

    def applied(self, laxity: Laxity) -> Laxity | None:
        """The table put right; None where it would be the same or break a rule of tables.

        Standard deviations keep their size where the unit changes, but for those too small to be
        in the unit that the table should have.
        """
        n = len(COORDINATES)
        order, factors = np.array(self.order), np.array(self.factors)
        protocol = laxity.protocol
        loads = protocol.loads[:, order[n:] - n] * factors[n:]
        coordinates = laxity.coordinates[:, order[:n]] * factors[:n]
        zero = laxity.zero if self.zero is None else self.zero
        flexion = protocol.flexion_deg * self.flexion
        same = (
            np.array_equal(loads, protocol.loads)
            and np.array_equal(coordinates, laxity.coordinates, equal_nan=True)
            and np.array_equal(flexion, protocol.flexion_deg)
        )
        # Columns of which one was not measured were not exchanged.
        moved = np.isnan(coordinates) != np.isnan(laxity.coordinates)
        if (same and zero == laxity.zero) or moved.any():
            return None
        try:
            return replace(
                laxity,
                protocol=replace(protocol, flexion_deg=flexion, loads=loads),
                coordinates=coordinates,
                sd=None if laxity.sd is None else self._sd(laxity.sd),
                zero=zero,
            )
        except ValueError:
            return None

    def _sd(self, sd: Array) -> Array:
        n = len(COORDINATES)
        moved = sd[:, list(self.order[:n])]
        scaled = np.abs(self.factors[:n]) * moved
        return np.where(moved < LEAST_SD, scaled, moved)


def conventions_of(laxity: Laxity) -> tuple[Convention, ...]:
    """The changes that would put right what people get wrong in a table such as this.

    Signs of columns, of whole motions and of all loads; units; the other side of the body; columns
    exchanged; and what coordinates are counted from.
    """
    return (*_signs(), *_sides(), *_units(), *_exchanges(), *_zeros(laxity))


def _signs() -> Iterator[Convention]:
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


def _sides() -> Iterator[Convention]:
    for what, names in (
        ("coordinates and loads", (*_SIDED, *_SIDED_LOADS)),
        ("coordinates", _SIDED),
        ("loads", _SIDED_LOADS),
    ):
        said = f"taking {what} for those of the other side (left for right)"
        yield Convention(what=said, factors=_negated(names))


def _units() -> Iterator[Convention]:
    for names, factor, unit, wanted in _UNITS:
        what = {_LENGTHS: "lengths", _ANGLES: "angles", _MOMENTS: "moments", _FORCES: "forces"}
        said = f"taking {what[names]} for {unit} and converting them to {wanted}"
        yield Convention(what=said, factors=_scaled(names, factor))
    for name in (*_LENGTHS, *_ANGLES):
        unit, factor = ("m", 1000.0) if name in _LENGTHS else ("radians", 180.0 / np.pi)
        yield Convention(what=f"taking {name} for {unit}", factors=_scaled((name,), factor))
    yield Convention(what=f"taking {FLEXION} for radians", flexion=180.0 / np.pi)


def _exchanges() -> Iterator[Convention]:
    for kind in (_LENGTHS, _ANGLES, _MOMENTS, _FORCES):
        for one, other in combinations(kind, 2):
            order = list(range(len(COLUMNS)))
            i, j = COLUMNS.index(one), COLUMNS.index(other)
            order[i], order[j] = j, i
            yield Convention(what=f"exchanging {one} and {other}", order=tuple(order))


def _zeros(laxity: Laxity) -> Iterator[Convention]:
    if laxity.zero == "unloaded":
        yield Convention(
            what="taking coordinates for absolute ones (without zero: unloaded)", zero="absolute"
        )
        return
    if laxity.zero != "absolute":
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
        zero="unloaded",
    )


def _negated(names: Sequence[str]) -> tuple[float, ...]:
    return _scaled(names, -1.0)


def _scaled(names: Sequence[str], factor: float) -> tuple[float, ...]:
    return tuple(factor if x in names else 1.0 for x in COLUMNS)


@declared
class BrokenConvention:
    """A convention whose change removes nearly all of the misfit, and leaves a plausible one."""

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
        what = self.what[:1].upper() + self.what[1:]
        return (
            f"{what} removes {min(100.0 * self.removed, 99.0):.0f} % of the misfit (the error "
            f"falls {falls}), and what is left is plausible: the table violates this convention, "
            f"and no fit to it is valid.{also} Correct the table and repeat the command."
        )

    @property
    def finding(self) -> Finding:
        """As an answer reports it."""
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


def find_broken_convention(
    model: LaxityModel, laxity: Laxity, start: Array, fitted: Array | None = None
) -> BrokenConvention | None:
    """The convention that explains why a model does not fit a table; None where none does.

    All are looked at where a fit would begin, with a straight model and the priors of the
    parameters. Only the few that promise most are fitted. Where the table as it is leaves no more
    than noise, nothing is looked for; trials without equilibrium at the start count nowhere.

    Parameters
    ----------
    model, laxity
        The model and the data.
    start
        Where fits begin, in all parameters of the model, shape ``(p,)``.
    fitted
        Parameters fitted to the table as it is, shape ``(p,)``; where None they are sought.
    """
    usable = _with_prediction(model, laxity, start)
    if usable is None:
        return None
    as_is = _Table(model, usable)
    theta = as_is.fitted(start) if fitted is None else fitted
    if not as_is.has_prediction(theta) or as_is.is_plausible(theta):
        return None
    found = []
    for convention, table in _promising(as_is, start):
        end = table.fitted(start)
        before, after = table.chi_square_of(as_is.differences(theta)), table.square(end)
        # What noise leaves in any table is no part of the misfit to be removed.
        noise = 0.0 if table.laxity.sd is None else min(after, table.degrees)
        if before - after >= REMOVED * (before - noise) and table.is_plausible_model_misfit(end):
            found.append((after, 1.0 - after / before, convention.what, table.errors(end)))
    if not found:
        return None
    least, removed, what, errors = min(found, key=lambda x: x[0])
    before_mm, before_deg = as_is.errors(theta)
    return BrokenConvention(
        what=what,
        removed=removed,
        mm_before=before_mm,
        deg_before=before_deg,
        mm_after=errors[0],
        deg_after=errors[1],
        others=tuple(x[2] for x in found if x[2] != what and x[0] <= AS_GOOD * least),
    )


def convention_findings(
    model: LaxityModel, laxity: Laxity, start: Array, fitted: Array | None = None
) -> tuple[Finding, ...]:
    """The convention that is broken, if one is.

    Where the model cannot tell, as on a knee without equilibrium at the start, the table alone
    shows whether the tibia moves against its load.

    Parameters
    ----------
    model, laxity, start, fitted
        As in `find_broken_convention`.
    """
    found = find_broken_convention(model, laxity, start, fitted)
    return load_sign_findings(laxity) if found is None else (found.finding,)


class _Table:
    """A table beside a model: what is left of it, in mm and deg and in units of its noise."""

    def __init__(self, model: LaxityModel, laxity: Laxity) -> None:
        self.laxity = laxity
        self.residuals = LaxityResiduals(model=model, laxity=laxity)
        self.sd = np.ones(laxity.coordinates.shape) if laxity.sd is None else laxity.sd
        self.degrees = max(
            int(laxity.is_measured.sum() - self.residuals.parameters.is_of_interest.sum()), 1
        )

    def fitted(self, start: Array) -> Array:
        """Parameters fitted to it with their priors, shape ``(p,)``."""
        problem = WhitenedResiduals(problem=self.residuals, sd=self.sd[self.laxity.is_measured])
        return fit(problem, start, method="least-squares", budget=BUDGET, priors=True).theta

    def has_prediction(self, theta: Array) -> bool:
        return bool(np.isfinite(self.residuals.residuals(theta)).all())

    def differences(self, theta: Array) -> Array:
        """Measured less predicted, shape ``(n, 5)``; NaN where not measured."""
        return self.residuals.differences(theta)

    def chi_square_of(self, differences: Array) -> float:
        """Sum of squares of differences in units of the noise of this table."""
        return float(np.nansum((differences / self.sd) ** 2))

    def square(self, theta: Array) -> float:
        """The same of what is left of this table."""
        return self.chi_square_of(self.differences(theta))

    def is_plausible(self, theta: Array) -> bool:
        """Whether noise alone may leave so much."""
        if self.laxity.sd is None:
            return self._is_small(theta)
        return bool(chdtrc(self.degrees, self.square(theta)) >= IMPROBABLE)

    def is_plausible_model_misfit(self, theta: Array) -> bool:
        """Whether the model of a knee may leave so much: seldom does it fit to the noise."""
        if self.laxity.sd is None:
            return self._is_small(theta)
        return self.square(theta) <= GROSS * self.degrees

    def errors(self, theta: Array) -> tuple[float, float]:
        """Root-mean-square of what is left [mm, deg]; NaN where nothing was measured."""
        squares = self.differences(theta) ** 2
        return _root_mean(squares[:, TRANSLATIONS]), _root_mean(squares[:, ROTATIONS])

    def straight(self, start: Array) -> Array:
        """What a straight model at `start`, with the priors, leaves, shape ``(n, 5)``."""
        measured, parameters = self.laxity.is_measured, self.residuals.parameters
        left = self.differences(start)
        slopes = -self.residuals.jacobian(start) * parameters.prior_sd_in_own_units
        sd = self.sd[measured]
        step = np.linalg.lstsq(
            np.vstack([slopes / sd[:, None], np.eye(parameters.n)]),
            np.r_[-left[measured] / sd, np.zeros(parameters.n)],
            rcond=None,
        )[0]
        left[measured] += slopes @ step
        return left

    def _is_small(self, theta: Array) -> bool:
        mm, deg = self.errors(theta)
        return not mm > MOST_MM and not deg > MOST_DEG


def _with_prediction(model: LaxityModel, laxity: Laxity, start: Array) -> Laxity | None:
    """The trials that have an equilibrium at the start; None where too few have."""
    prediction = model.with_tests(laxity).predict(start, derivatives=False)
    usable = prediction.is_converged & laxity.is_measured.any(axis=1)
    if usable.sum() < max(LEAST_SHARE * laxity.is_measured.any(axis=1).sum(), 1):
        return None
    return laxity if prediction.all_converged else _selected(laxity, prediction.is_converged)


def _selected(laxity: Laxity, rows: BoolArray) -> Laxity | None:
    try:
        part = laxity.select(rows)
        if laxity.zero == "unloaded":
            unloaded_trials(part.protocol)
    except ValueError:
        return None
    return part


def _promising(as_is: _Table, start: Array) -> list[tuple[Convention, _Table]]:
    """The conventions worth a fit, the most promising first."""
    here, found = as_is.straight(start), []
    for convention in conventions_of(as_is.laxity):
        changed = convention.applied(as_is.laxity)
        if changed is None:
            continue
        table = _Table(as_is.residuals.model, changed)
        if not table.has_prediction(start):
            continue
        share = table.chi_square_of(table.straight(start)) / table.chi_square_of(here)
        if share <= PROMISED:
            found.append((share, convention, table))
    found.sort(key=lambda x: x[0])
    return [(convention, table) for _, convention, table in found[:MOST_FITS]]


def _root_mean(squares: Array) -> float:
    known = squares[~np.isnan(squares)]
    return float(np.sqrt(known.mean())) if known.size else float("nan")
