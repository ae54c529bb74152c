"""Trials that the others contradict, by leave-one-out residuals of a fit or by the table alone."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import fdtrc

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import WhitenedResiduals, restricted, typical_steps
from identknee.laxity.protocol import Protocol, dominant_loads
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.laxity.trial_words import load_words
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry
from identknee.runs.findings import Finding, finding
from identknee.runs.words import amount, label_without_unit, listed, unit_of

# How often a clean table may be accused, shared by looks at whole trials and at single values.
LEVEL = 0.01
# Share of the trials that may be blunders; where more stand out it is the model that is wrong.
MOST_SHARE = 0.1
# What is left of a value by the fitted parameters, below which nothing can be said of it.
LEAST_LEFT = 1e-6
# Mean square in units of the noise below which data are free of noise, and rounding is left.
LEAST_SQUARE = 1e-6
# Of a direction of load, fewer trials say nothing of how coordinates change with flexion.
LEAST_TRIALS = 4
# How often a table may be accused for which the courses are right; they are nearly so, not quite.
TABLE_LEVEL = 1e-4
# Loads of one direction may differ by this share of them and still be one end point.
ALIKE = 0.25
# A sentence lists values of a trial from this many standard errors on, and so many at most.
LISTED, MOST_LISTED = 3.0, 3
BUDGET = 80
# Part of a parameter's range, and typical steps: at a bound, and a change worth a word.
AT_END, WORTH = 1e-6, 0.1
# Of a normal error to its median size.
NORMAL = 1.4826
# What contradicts a trial, by the code of the finding.
AGAINST = {
    "trial-against-fit": "the prediction of the fit to the other trials",
    "trial-against-course": "the course of the other trials over flexion",
}


@declared
class SuspiciousRow:
    """A contradictory trial, its worst values first."""

    trial: int = entry("Its place among the trials")
    coordinates: IntArray = array("Places of its coordinates", "value", dtype=int)
    off: Array = array("How far each is from what the other trials say", "value", unit="mm or deg")
    errors: Array = array("Standard errors of those distances", "value", unit="mm or deg")
    p_value: float = entry("How often one of so many is as far off by chance", unit="1")

    @property
    def times(self) -> Array:
        """How far off each is in its standard errors."""
        return np.abs(self.off) / self.errors


@declared
class LeaveOneOut:
    """Leave-one-out residuals of a fit, for any subset of the measured values.

    A value that is wrong by ``x`` adds ``x`` times its column to what is left. With one more
    parameter for each value left out this is exact for a straight model.
    """

    products: Array = array("Inner products of those columns", "value", "value")
    left: Array = array("Inner products of what is left with them", "value")
    square: float = entry("Sum of squares of what is left", unit="1")
    degrees: int = entry("Degrees of freedom of it", unit="1")

    def fall(self, chosen: IntArray) -> float:
        """By how much the square falls without the values `chosen`."""
        block = self.products[np.ix_(chosen, chosen)]
        return float(self.left[chosen] @ _inverse(block) @ self.left[chosen])

    def without(self, chosen: IntArray) -> "LeaveOneOut":
        """What is left without the values `chosen`."""
        block, columns = self.products[np.ix_(chosen, chosen)], self.products[:, chosen]
        half = _inverse(block) @ np.column_stack([columns.T, self.left[chosen]])
        return LeaveOneOut(
            products=self.products - columns @ half[:, :-1],
            left=self.left - columns @ half[:, -1],
            square=max(self.square - self.fall(chosen), 0.0),
            degrees=self.degrees - len(chosen),
        )


def _inverse(block: Array) -> Array:
    """Of inner products, some of which may be nothing but others together."""
    return np.asarray(np.linalg.pinv(block, rcond=LEAST_LEFT, hermitian=True), float)


def leave_one_out(residuals: Array, jacobian: Array, columns: Array) -> LeaveOneOut:
    """What a fit leaves, from its residuals in units of their noise.

    Parameters
    ----------
    residuals
        Measured less predicted, whitened, rows of priors included, shape ``(m,)``.
    jacobian
        Their derivatives by the parameters that are free, shape ``(m, p)``.
    columns
        How each measured value enters the residuals, shape ``(m, k)``.
    """
    sizes = np.linalg.norm(jacobian, axis=0)
    used = jacobian[:, sizes > 0.0] / sizes[sizes > 0.0]
    basis, spread, _ = np.linalg.svd(used, full_matrices=False)
    basis = basis[:, spread > LEAST_LEFT * spread.max(initial=0.0)]
    rest = residuals - basis @ (basis.T @ residuals)
    free = columns - basis @ (basis.T @ columns)
    return LeaveOneOut(
        products=free.T @ free,
        left=free.T @ rest,
        square=float(rest @ rest),
        degrees=len(residuals) - basis.shape[1],
    )


def suspicious_rows(
    fit: LeaveOneOut, trials: IntArray, coordinates: IntArray, *, level: float = LEVEL
) -> list[SuspiciousRow]:
    """The trials that the others contradict, the worst first; none where there are too many.

    One trial at a time is left out, each judged by a scale that it has no part in (an F test of
    the whole trial and of each of its values, Bonferroni over all), then the rest are judged again
    without it.

    Parameters
    ----------
    fit
        What the fit leaves.
    trials, coordinates
        Trial and coordinate of each value, shape ``(k,)``.
    level
        How often a clean table may be accused.
    """
    found: list[SuspiciousRow] = []
    names = np.unique(trials)
    if fit.square < LEAST_SQUARE * fit.degrees:
        return found
    while fit.degrees > len(names) // 2:
        looked = [(_p_value_of(fit, trials, x), x) for x in names.tolist()]
        p_value, worst = min(looked, default=(1.0, -1))
        if p_value > level:
            return found
        if len(found) >= max(1, int(MOST_SHARE * len(names))):
            return []
        own = _seen(fit, trials, worst)
        found.append(_described(fit, own, worst, coordinates, p_value))
        fit = fit.without(own)
    return found


def _p_value_of(fit: LeaveOneOut, trials: IntArray, trial: int) -> float:
    """Of one trial, as one of all trials and of all values; 1 where nothing can be said."""
    own = _seen(fit, trials, trial)
    if not own.size or fit.degrees <= own.size:
        return 1.0
    whole = _p_value(fit, fit.fall(own), own.size)
    single = _p_value(fit, float((fit.left[own] ** 2 / np.diag(fit.products)[own]).max()), 1)
    return min(1.0, 2.0 * min(np.unique(trials).size * whole, trials.size * single))


def _described(
    fit: LeaveOneOut, own: IntArray, trial: int, coordinates: IntArray, p_value: float
) -> SuspiciousRow:
    size = np.diag(fit.products)[own]
    off = fit.left[own] / size
    errors = np.sqrt(max(fit.square - fit.fall(own), 0.0) / (fit.degrees - own.size) / size)
    order = np.argsort(-np.abs(off) / errors)
    return SuspiciousRow(
        trial=trial,
        coordinates=coordinates[own[order]],
        off=off[order],
        errors=errors[order],
        p_value=p_value,
    )


def _p_value(fit: LeaveOneOut, fall: float, k: int) -> float:
    """Probability of so great a fall of the square by chance if `k` values are left out."""
    degrees = fit.degrees - k
    rest = max(fit.square - fall, 0.0) / degrees
    return float(fdtrc(k, degrees, fall / k / rest)) if rest > 0.0 else 1.0


def _seen(fit: LeaveOneOut, trials: IntArray, trial: int) -> IntArray:
    """The values of a trial whose change the parameters and trials left out cannot make up for."""
    chosen = np.flatnonzero(trials == trial)
    size = np.diag(fit.products)
    return np.asarray(chosen[size[chosen] > LEAST_LEFT * size.max()])


def suspicious_end_points(laxity: Laxity) -> list[SuspiciousRow]:
    """Trials off the course over flexion that others of their load and all others have.

    Every coordinate is a straight line over flexion for each direction of load, bent alike for all
    directions. This is for tables with one load a direction, such as end points of a robot; of
    others nothing is said.
    """
    rows, design = _courses_over_flexion(laxity.protocol)
    values = laxity.coordinates[rows]
    measured = ~np.isnan(values)
    parts = [(values[use, j], design[use]) for j, use in enumerate(measured.T) if use.any()]
    if not rows.size or any(len(x) <= X.shape[1] for x, X in parts):
        return []
    scales = [_scale(x, X) for x, X in parts]
    spread = np.concatenate([np.full(len(x), s) for (x, _), s in zip(parts, scales, strict=True)])
    fit = leave_one_out(
        np.concatenate([x for x, _ in parts]) / spread,
        block_diag(*[X for _, X in parts]) / spread[:, None],
        np.diag(1.0 / spread),
    )
    coordinates, places = np.nonzero(measured.T)
    return suspicious_rows(fit, rows[places], coordinates, level=TABLE_LEVEL)


def _courses_over_flexion(protocol: Protocol) -> tuple[IntArray, Array]:
    """The trials that can be compared, and the course over flexion that each is on."""
    found = dominant_loads(protocol)
    group = np.where(found.axis < 0, 0, np.sign(found.size) * (found.axis + 1)).astype(int)
    usable = [x for x in np.unique(group) if np.count_nonzero(group == x) >= LEAST_TRIALS]
    for direction in usable:
        size = np.abs(found.size[group == direction])
        if size.min() < (1.0 - ALIKE) * size.max():
            return np.zeros(0, dtype=np.int64), np.zeros((0, 0))
    rows = np.flatnonzero(np.isin(group, usable))
    turn = (protocol.flexion_deg[rows] - 45.0) / 45.0
    own = (group[rows, None] == np.array(usable, dtype=int)).astype(float)
    return rows, np.hstack([own, own * turn[:, None], turn[:, None] ** 2])


def _scale(values: Array, design: Array) -> float:
    """Spread of what the courses leave, which one trial that is off cannot widen much."""
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    free = np.sqrt(len(values) / (len(values) - np.linalg.matrix_rank(design)))
    return max(float(1.4826 * np.median(np.abs(left)) * free), 1e-6)


def row_findings(
    model: LaxityModel, laxity: Laxity, theta: Array, *, fixed: Sequence[str] = ()
) -> tuple[Finding, ...]:
    """The trials that a fit to all others contradicts, and the fit without them.

    Parameters
    ----------
    model, laxity
        What was fitted to what.
    theta
        The fit, shape ``(p,)``.
    fixed
        Names of parameters that were held.
    """
    rows = contradicted_rows(model, laxity, theta, fixed=fixed)
    if not rows:
        return ()
    rest = without_rows(laxity, rows)
    compared = LaxityResiduals(model=model, laxity=rest)
    part = restricted(
        WhitenedResiduals(problem=compared, sd=_scales(compared, theta)), fixed, theta
    )
    begin = part.free.restrict(theta)
    end = part.free.expand(fit(part, begin, method="least-squares", budget=BUDGET).theta)
    before = LaxityResiduals(model=model, laxity=laxity).differences(theta)
    after = compared.differences(end)
    values: dict[str, object] = {}
    falls = []
    for x, unit in ((TRANSLATIONS, "mm"), (ROTATIONS, "deg")):
        if np.isfinite(after[:, x]).any():
            first, then = _root_mean(before[:, x]), _root_mean(after[:, x])
            values |= {f"rmse_{unit}": first, f"rmse_without_{unit}": then}
            falls.append(f"from {first:.3g} to {then:.3g} {unit}")
    moved = np.abs(end - theta) / typical_steps(model.parameters)
    k = int(np.argmax(moved))
    name = model.parameters.names[k]
    change = ""
    if moved[k] > WORTH:
        values |= {name: theta[k], f"{name} without": end[k]}
        change = (
            f", and the {label_without_unit(name)} changes from {amount(theta[k], '')} to "
            f"{amount(end[k], unit_of(name))}"
        )
    it = "it" if len(rows) == 1 else "these trials"
    without = f"Without {it} the error of the fit goes {' and '.join(falls)}{change}."
    return trial_findings(rows, laxity, "trial-against-fit", then=(without, values))


def end_point_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """The trials that the table alone contradicts, for where no model can be asked."""
    return trial_findings(suspicious_end_points(laxity), laxity, "trial-against-course")


def contradicted_rows(
    model: LaxityModel, laxity: Laxity, theta: Array, *, fixed: Sequence[str] = ()
) -> list[SuspiciousRow]:
    """The trials themselves, the worst first; see `row_findings`."""
    is_stated = laxity.sd is not None and not np.isnan(laxity.sd[laxity.is_measured]).any()
    compared = LaxityResiduals(
        model=model, laxity=laxity, weighting="noise" if is_stated else "unit"
    )
    left = compared.residuals(theta)
    if not np.isfinite(left).all():
        return []
    jacobian = compared.jacobian(theta)[:, _unconstrained_parameters(model, theta, fixed)]
    columns = compared.weighted(_unit_errors(laxity))
    whiten = np.ones(left.size) if is_stated else 1.0 / _scales(compared, theta)
    fitted = leave_one_out(-left * whiten, jacobian * whiten[:, None], columns * whiten[:, None])
    return suspicious_rows(fitted, *np.nonzero(laxity.is_measured))


def without_rows(laxity: Laxity, rows: Iterable[SuspiciousRow]) -> Laxity:
    """The same laxity with these trials left blank."""
    coordinates = np.array(laxity.coordinates)
    coordinates[[x.trial for x in rows]] = np.nan
    return replace(laxity, coordinates=coordinates)


def trial_findings(
    rows: Sequence[SuspiciousRow],
    laxity: Laxity,
    code: str,
    *,
    then: tuple[str, Mapping[str, object]] = ("", {}),
) -> tuple[Finding, ...]:
    """Contradicted trials as findings, the trial's name as where.

    Parameters
    ----------
    rows
        What was found.
    laxity
        The data.
    code
        ``trial-against-fit`` or ``trial-against-course``.
    then
        What follows without all of them, as a sentence and its values; the last finding has it.
    """
    found = []
    for row in rows:
        trial, load = laxity.protocol.trials[row.trial], load_words(laxity.protocol, row.trial)
        differences, values = _differences(row)
        chance = f"{row.p_value:.1g}" if row.p_value >= 1e-6 else "less than 1e-06"
        sentence = (
            f"{trial} is inconsistent with the other trials: under {load} its "
            f"{listed(differences)} than {AGAINST[code]}. The probability of such an outlier "
            f"among as many trials is {chance}. Check the trial, and leave its cells blank if "
            "it is wrong."
        )
        values |= {"load": load, "p_value": row.p_value}
        if row is rows[-1] and then[0]:
            sentence, values = f"{sentence} {then[0]}", values | {**then[1]}
        found.append(finding(code, trial, values, sentence=sentence))
    return tuple(found)


def _differences(row: SuspiciousRow) -> tuple[list[str], dict[str, object]]:
    """How far off the worst values of a trial are, in words and as values."""
    found = list(zip(row.coordinates.tolist(), row.off.tolist(), row.times.tolist(), strict=True))
    clear = [x for k, x in enumerate(found) if k == 0 or x[2] > LISTED][:MOST_LISTED]
    said, values = [], {}
    for k, off, times in clear:
        words, _, unit = COORDINATES[k].replace("internal", "internal_rotation").rpartition("_")
        size = f"{abs(off):.2g} {unit} {'larger' if off > 0.0 else 'smaller'}"
        said.append(f"{words.replace('_', ' ')} is {size} ({times:.2g} times its error)")
        values[f"off_{COORDINATES[k]}"] = off
    return said, values


def _unconstrained_parameters(model: LaxityModel, theta: Array, fixed: Sequence[str]) -> list[int]:
    """Parameters that could have moved: neither fixed nor at a bound."""
    own = model.parameters
    margin = AT_END * (own.upper - own.lower)
    inside = (theta > own.lower + margin) & (theta < own.upper - margin)
    return [k for k, name in enumerate(own.names) if inside[k] and name not in fixed]


def _scales(compared: LaxityResiduals, theta: Array) -> Array:
    """Standard deviation of every residual: as stated, or from what is left of its kind."""
    laxity = compared.laxity
    measured = laxity.is_measured
    if laxity.sd is not None and not np.isnan(laxity.sd[measured]).any():
        return np.array(laxity.sd[measured])
    left = np.abs(compared.residuals(theta))
    scales = np.ones(left.size)
    for kind in np.unique(compared.units):
        own = compared.units == kind
        scales[own] = max(NORMAL * float(np.median(left[own])), AT_END)
    return scales


def _unit_errors(laxity: Laxity) -> Array:
    """A unit error in each measured value alone, shape ``(n, 5, m)``."""
    trials, coordinates = np.nonzero(laxity.is_measured)
    errors = np.zeros((*laxity.coordinates.shape, trials.size))
    errors[trials, coordinates, np.arange(trials.size)] = 1.0
    return errors


def _root_mean(values: Array) -> float:
    known = values[~np.isnan(values)]
    return float(np.sqrt((known**2).mean())) if known.size else float("nan")
