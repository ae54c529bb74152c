"""Checks of a laxity table: loads, frames, conventions, and trials that contradict the others."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_array, diags_array
from scipy.special import fdtrc

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import WhitenedResiduals, restricted, typical_steps
from identknee.laxity.protocol import (
    LOADS,
    Protocol,
    dominant_loads,
    opposite_pairs,
)
from identknee.laxity.table import (
    COORDINATES,
    ROTATIONS,
    TRANSLATIONS,
    WORKS_ON,
    Laxity,
    root_mean,
)
from identknee.laxity.trial_words import load_words
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array, BoolArray, IntArray, array, declared, entry
from identknee.runs.findings import Finding, finding
from identknee.runs.words import amount, label_without_unit, listed, unit_of

# Probability below which a misfit is doubtful, and times the misfit of noise above which a mistake
# in the data is likely: residuals three times as large as the noise.
IMPROBABLE, GROSS = 1e-3, 9.0
# Twice the error of simple laxity devices against a robot, which is about 1 mm and 2.5 deg.
MOST_MM, MOST_DEG = 2.0, 5.0
# Share of its length in the scan below which a ligament is too short. Some may be, such as the
# posterior capsule in deep flexion, but not half of all ligaments in half of the trials.
SHORT = 0.75
# Least difference between the poses under opposite loads that shows their sign [mm, deg].
LEAST = 2.0


def load_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """A finding if no trial has a load, as in a table without columns of loads."""
    return () if laxity.protocol.loads.any() else (finding("no-loads", "data"),)


def frame_findings(model: LaxityModel) -> tuple[Finding, ...]:
    """A finding if measured poses put the insertions of half the ligaments far too close."""
    ligaments = model.knee.ligaments
    setting = model.setting(model.parameters.start)
    if setting.measured is None:
        return ()
    places, lines = zip(setting.flexion.tolist(), setting.measured, strict=True), setting.lines
    lengths = np.array([line_lengths(lines, angle, pose) for angle, pose in places])
    usual = (np.median(lengths, axis=0) / lines.reference_length)[: len(ligaments)]
    n_short = int(np.count_nonzero(usual < SHORT))
    if 2 * n_short < len(ligaments):
        return ()
    worst = int(np.argmin(usual))
    values = {
        "n_short": n_short,
        "n_ligaments": len(ligaments),
        "shortest": ligaments[worst].name,
        "length_in_scan_pct": 100.0 * usual[worst],
    }
    sentence = (
        "The coordinates are not those of this subject's frames: in half of the measured poses "
        f"{n_short} of {len(ligaments)} ligaments have less than {100 * SHORT:.0f} % of their "
        f"length in the scan ({ligaments[worst].name} {100 * usual[worst]:.0f} %). If they are "
        "changes from a pose of the knee, say from which in a line of the table: # zero: unloaded, "
        "# zero: opposite, or # zero: and the name of a trial."
    )
    return (finding("coordinates-of-other-frames", "data", values, sentence=sentence),)


def load_sign_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """A finding for each load under which the tibia moves the wrong way, from the table alone.

    At a stable equilibrium a load moves the tibia in its own direction. A column is named only if
    most pairs of opposite loads move it the other way, by more than a stray load or noise explains.
    """
    pairs = opposite_pairs(laxity.protocol)
    axis = dominant_loads(laxity.protocol).axis
    found = []
    for k, (load, coordinate) in enumerate(zip(LOADS, WORKS_ON, strict=True)):
        own = pairs[axis[pairs[:, 0]] == k]
        column = laxity.coordinates[:, COORDINATES.index(coordinate)]
        moved = column[own[:, 0]] - column[own[:, 1]]
        moved = moved[~np.isnan(moved)]
        if moved.size < 2 or np.median(moved) > -LEAST:
            continue
        unit = "deg" if coordinate.endswith("_deg") else "mm"
        values = {
            "coordinate": coordinate,
            "load": load,
            f"fall_{unit}": -np.median(moved),
            "n_pairs": moved.size,
        }
        sentence = (
            f"{coordinate} falls as {load} rises, by {-np.median(moved):.3g} {unit} between "
            f"opposite loads in the middle of {moved.size} pairs of trials; no knee moves against "
            "an applied load. The sign of one of the two columns is flipped, or two columns are "
            "exchanged. Correct the table and repeat the command."
        )
        found.append(finding("moves-against-load", "data", values, sentence=sentence))
    return tuple(found)


# Probability of naming a trial of a clean table, for tests of trials and of values together.
LEVEL = 0.01
# Share of the trials that may be outliers; if more stand out, the model is wrong.
MOST_SHARE = 0.1
# Relative size below which a residual or a singular value is rounding.
LEAST_LEFT = 1e-6
# Mean square in units of the noise below which data are free of noise, and only rounding is left.
LEAST_SQUARE = 1e-6
# Fewest flexion angles of one load direction from which a course over flexion is fitted, and how
# far the angles of repeated trials may differ [deg].
LEAST_ANGLES, FLEXION_ALIKE = 4, 2.0
# The same as LEVEL for courses over flexion: smaller, since coordinates follow them only nearly.
TABLE_LEVEL = 1e-4
# Share by which loads of one direction may differ and still be one end point.
ALIKE = 0.25
# Standard errors from which a sentence lists a value of a trial, and the most values it lists.
LISTED, MOST_LISTED = 3.0, 3
BUDGET = 80
# Share of a parameter's range that counts as at a bound; typical steps that count as a change.
AT_END, WORTH = 1e-6, 0.1
# Standard deviation of a normal error over its median absolute size.
NORMAL = 1.4826
# Least standard deviation assumed of residuals [mm, deg], so that an exact fit divides by no zero.
LEAST_SCALE = 1e-6
# What a trial is inconsistent with, by the code of the finding.
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

    A value that is wrong by ``x`` adds ``x`` times its column to the residuals. To leave values out
    is to fit one more parameter for each, which is exact for a linear model. Columns projected off
    the parameters have the inner products ``own - explained' explained``, so that no dense matrix
    of all values by all values is needed.
    """

    own: Any = entry("Inner products of the columns themselves, sparse, shape ``(k, k)``")
    explained: Array = array(
        "Parts of the columns that the parameters, and values left out, make up for",
        *("direction", "value"),
    )
    left: Array = array("Inner products of the residuals with the columns", "value")
    square: float = entry("Sum of squares of the residuals", unit="1")
    degrees: int = entry("Their degrees of freedom", unit="1")

    @property
    def sizes(self) -> Array:
        """Inner product of each column with itself, shape ``(k,)``."""
        return np.asarray(self.own.diagonal() - (self.explained**2).sum(axis=0))

    def falls(self, chosen: IntArray, is_used: BoolArray) -> Array:
        """Reduction of the sum of squares without one of several groups of values, shape ``(t,)``.

        Parameters
        ----------
        chosen
            The values of each group, shape ``(t, w)``.
        is_used
            Those of them that count, shape ``(t, w)``.
        """
        left = np.where(is_used, self.left[chosen], 0.0)
        blocks = self._blocks(chosen) * (is_used[:, :, None] & is_used[:, None, :])
        # Values of one group may be linearly dependent.
        inverse = np.linalg.pinv(blocks, rcond=LEAST_LEFT, hermitian=True)
        return np.asarray(np.einsum("ti,tij,tj->t", left, inverse, left))

    def without(self, chosen: IntArray) -> "LeaveOneOut":
        """Residuals of the fit without the values `chosen`."""
        explained = self.explained
        products = self.own[chosen].toarray() - explained[:, chosen].T @ explained
        values, vectors = np.linalg.eigh(products[:, chosen])
        is_seen = values > LEAST_LEFT * np.abs(values).max()
        roots = vectors[:, is_seen] / np.sqrt(values[is_seen])
        off, rows = roots.T @ self.left[chosen], roots.T @ products
        return LeaveOneOut(
            own=self.own,
            explained=np.vstack([explained, rows]),
            left=self.left - off @ rows,
            square=max(self.square - float(off @ off), 0.0),
            degrees=self.degrees - len(chosen),
        )

    def _blocks(self, chosen: IntArray) -> Array:
        """Inner products within each group of values, shape ``(t, w, w)``."""
        trials, width = chosen.shape
        own = self.own[np.repeat(chosen, width, axis=1), np.tile(chosen, (1, width))]
        explained = self.explained.T[chosen]
        return np.asarray(own.toarray().reshape(trials, width, width) - explained @ explained.mT)


def leave_one_out(residuals: Array, jacobian: Array, columns: Any) -> LeaveOneOut:
    """Leave-one-out residuals of a fit, from its residuals in units of their noise.

    Parameters
    ----------
    residuals
        Measured less predicted, whitened, rows of priors included, shape ``(m,)``.
    jacobian
        Their derivatives by the parameters that are free, shape ``(m, p)``.
    columns
        How each measured value enters the residuals, shape ``(m, k)``; a sparse matrix where there
        are many.
    """
    sizes = np.linalg.norm(jacobian, axis=0)
    used = jacobian[:, sizes > 0.0] / sizes[sizes > 0.0]
    basis, spread, _ = np.linalg.svd(used, full_matrices=False)
    basis = basis[:, spread > LEAST_LEFT * spread.max(initial=0.0)]
    rest = residuals - basis @ (basis.T @ residuals)
    sparse = csr_array(columns)
    return LeaveOneOut(
        own=sparse.T @ sparse,
        explained=(sparse.T @ basis).T,
        left=sparse.T @ rest,
        square=float(rest @ rest),
        degrees=len(residuals) - basis.shape[1],
    )


def suspicious_rows(
    fit: LeaveOneOut, trials: IntArray, coordinates: IntArray, *, level: float = LEVEL
) -> list[SuspiciousRow]:
    """The trials that the others contradict, the worst first; none where there are too many.

    Each trial is compared with the residual variance without it, by an F test of the whole trial
    and of each of its values, with Bonferroni's correction for all tests. The worst is left out,
    and the others are tested again without it.

    Parameters
    ----------
    fit
        Residuals of the fit.
    trials, coordinates
        Trial and coordinate of each value, shape ``(k,)``.
    level
        Probability of naming a trial of a clean table.
    """
    found: list[SuspiciousRow] = []
    names, values, is_own = _by_trial(trials)
    if fit.square < LEAST_SQUARE * fit.degrees:
        return found
    while names.size and fit.degrees > len(names) // 2:
        sizes = fit.sizes
        # Values whose error neither the parameters nor trials left out before can absorb.
        is_seen = is_own & (sizes[values] > LEAST_LEFT * sizes.max())
        falls = fit.falls(values, is_seen)
        p_values = _p_values_of(fit, np.where(is_seen, sizes[values], np.inf), values, falls)
        worst = int(np.argmin(p_values))
        if p_values[worst] > level:
            return found
        if len(found) >= max(1, int(MOST_SHARE * len(names))):
            return []
        own = values[worst, is_seen[worst]]
        size = sizes[own]
        off = fit.left[own] / size
        errors = np.sqrt(max(fit.square - falls[worst], 0.0) / (fit.degrees - own.size) / size)
        order = np.argsort(-np.abs(off) / errors)
        found.append(
            SuspiciousRow(
                trial=int(names[worst]),
                coordinates=coordinates[own[order]],
                off=off[order],
                errors=errors[order],
                p_value=float(p_values[worst]),
            )
        )
        fit = fit.without(own)
    return found


def _by_trial(trials: IntArray) -> tuple[IntArray, IntArray, BoolArray]:
    """The trials (t,), the indices of their values (t, w), and which entries of these are used."""
    names, group, count = np.unique(trials, return_inverse=True, return_counts=True)
    order = np.argsort(group, kind="stable")
    values = np.zeros((names.size, count.max(initial=0)), dtype=np.int64)
    is_own = np.arange(values.shape[1]) < count[:, None]
    values[is_own] = order
    return names, values, is_own


def _p_values_of(fit: LeaveOneOut, sizes: Array, values: IntArray, falls: Array) -> Array:
    """P-value of each trial, corrected for the number of tests; 1 where no test is possible."""
    counts = np.isfinite(sizes).sum(axis=1)
    single = (fit.left[values] ** 2 / sizes).max(axis=1)
    by_trial, by_value = _p_values(fit, falls, counts), _p_values(fit, single, np.ones_like(counts))
    both = 2.0 * np.minimum(len(values) * by_trial, len(fit.left) * by_value)
    return np.where((counts == 0) | (fit.degrees <= counts), 1.0, np.minimum(1.0, both))


def _p_values(fit: LeaveOneOut, falls: Array, counts: IntArray) -> Array:
    """P-value of the fall of the sum of squares when `counts` values are left out."""
    degrees, k = np.maximum(fit.degrees - counts, 1), np.maximum(counts, 1)
    rest = np.maximum(fit.square - falls, 0.0) / degrees
    is_known = rest > 0.0
    ratio = falls / k / np.where(is_known, rest, 1.0)
    return np.where(is_known, fdtrc(k, degrees, ratio), 1.0)


def suspicious_end_points(laxity: Laxity) -> list[SuspiciousRow]:
    """Trials that depart from the trend over flexion of the others.

    Every coordinate is fitted by a parabola over flexion, with an offset and a slope for each
    direction of load and one curvature for all. This needs a table with one load for each
    direction, such as end points of a robot; for others the result is empty. Repeated trials count
    once, by their mean, and are not named: each departs from a parabola as the others do.
    """
    rows, point, design = _courses_over_flexion(laxity.protocol)
    count = np.bincount(point, minlength=len(design))
    values = np.full((len(design), len(COORDINATES)), np.nan)
    for j, column in enumerate(laxity.coordinates[rows].T):
        used = ~np.isnan(column)
        n = np.bincount(point[used], minlength=len(design))
        sums = np.bincount(point[used], column[used], minlength=len(design))
        values[n > 0, j] = sums[n > 0] / n[n > 0]
    measured = ~np.isnan(values)
    parts = [(values[use, j], design[use]) for j, use in enumerate(measured.T) if use.any()]
    if not parts or any(len(x) <= X.shape[1] for x, X in parts):
        return []
    scales = [_scale(x, X) for x, X in parts]
    spread = np.concatenate([np.full(len(x), s) for (x, _), s in zip(parts, scales, strict=True)])
    fit = leave_one_out(
        np.concatenate([x for x, _ in parts]) / spread,
        block_diag(*[X for _, X in parts]) / spread[:, None],
        diags_array(1.0 / spread),
    )
    coordinates, places = np.nonzero(measured.T)
    found = suspicious_rows(fit, places, coordinates, level=TABLE_LEVEL)
    return [replace(x, trial=int(rows[point == x.trial][0])) for x in found if count[x.trial] == 1]


def _courses_over_flexion(protocol: Protocol) -> tuple[IntArray, IntArray, Array]:
    """Rows of the trials that can be compared, their point, and the design matrix of the points.

    A point is a direction of load at a flexion angle, to within `FLEXION_ALIKE`.
    """
    found = dominant_loads(protocol)
    group = np.where(found.axis < 0, 0, np.sign(found.size) * (found.axis + 1)).astype(int)
    order = np.lexsort((protocol.flexion_deg, group))
    is_new = np.diff(group[order]) != 0
    is_new |= np.diff(protocol.flexion_deg[order]) > FLEXION_ALIKE
    point = np.empty(protocol.n, dtype=np.int64)
    point[order] = np.concatenate([[0], np.cumsum(is_new)])
    usable = [x for x in np.unique(group) if np.unique(point[group == x]).size >= LEAST_ANGLES]
    for direction in usable:
        size = np.abs(found.size[group == direction])
        if size.min() < (1.0 - ALIKE) * size.max():
            usable = []
            break
    rows = np.flatnonzero(np.isin(group, usable))
    _, first, places = np.unique(point[rows], return_index=True, return_inverse=True)
    own = rows[first]
    turn = (protocol.flexion_deg[own] - 45.0) / 45.0
    offset = (group[own, None] == np.array(usable, dtype=int)).astype(float)
    return rows, places, np.hstack([offset, offset * turn[:, None], turn[:, None] ** 2])


def _scale(values: Array, design: Array) -> float:
    """Standard deviation of the residuals of a course, robust against single outliers."""
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    free = np.sqrt(len(values) / (len(values) - np.linalg.matrix_rank(design)))
    return max(float(NORMAL * np.median(np.abs(left)) * free), LEAST_SCALE)


def row_findings(
    model: LaxityModel, laxity: Laxity, theta: Array, *, fixed: Sequence[str] = ()
) -> tuple[Finding, ...]:
    """A finding for each trial that a fit to all others contradicts; the last has that fit."""
    rows = contradicted_rows(model, laxity, theta, fixed=fixed)
    if not rows:
        return ()
    compared = LaxityResiduals(model=model, laxity=without_rows(laxity, rows))
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
            first, then = root_mean(before[:, x] ** 2), root_mean(after[:, x] ** 2)
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
    """A finding for each trial that the table alone contradicts, without a model."""
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
    # Parameters that could have moved: neither fixed nor at a bound.
    own = model.parameters
    margin = AT_END * (own.upper - own.lower)
    inside = (theta > own.lower + margin) & (theta < own.upper - margin)
    jacobian = compared.jacobian(theta)[
        :, [k for k, name in enumerate(own.names) if inside[k] and name not in fixed]
    ]
    # Errors of one trial change the residuals of that trial only.
    unit = np.broadcast_to(np.eye(len(COORDINATES)), (laxity.n, *2 * [len(COORDINATES)]))
    columns = columns_by_trial(compared.weighted(unit), laxity.is_measured)
    whiten = np.ones(left.size) if is_stated else 1.0 / _scales(compared, theta)
    fitted = leave_one_out(
        -left * whiten, jacobian * whiten[:, None], diags_array(whiten) @ columns
    )
    return suspicious_rows(fitted, *np.nonzero(laxity.is_measured))


def columns_by_trial(rows: Array, is_measured: BoolArray) -> csr_array:
    """Sparse derivatives of the residuals by the measured values, trial by trial.

    Parameters
    ----------
    rows
        Change of each residual by an error of 1 in each coordinate of its trial, shape ``(m, 5)``.
    is_measured
        Which values there are, shape ``(n, 5)``.

    Returns
    -------
    columns
        Shape ``(m, m)``.
    """
    trial = np.nonzero(is_measured)[0]
    place = np.cumsum(is_measured).reshape(is_measured.shape) - 1
    row, coordinate = np.nonzero(is_measured[trial])
    column = place[trial[row], coordinate]
    return csr_array((rows[row, coordinate], (row, column)), shape=(len(rows), len(rows)))


def without_rows(laxity: Laxity, rows: Iterable[SuspiciousRow]) -> Laxity:
    """The laxity with these trials left blank."""
    return laxity.without(np.isin(np.arange(laxity.n), [x.trial for x in rows]))


def trial_findings(
    rows: Sequence[SuspiciousRow],
    laxity: Laxity,
    code: str,
    *,
    then: tuple[str, Mapping[str, object]] = ("", {}),
    is_left_out: bool = False,
) -> tuple[Finding, ...]:
    """A finding for each contradicted trial, located by the name of the trial.

    Parameters
    ----------
    rows
        The contradicted trials.
    laxity
        The data.
    code
        ``trial-against-fit`` or ``trial-against-course``.
    then
        Sentence and values about the fit without all of them, for the last finding.
    is_left_out
        Whether the trials were left out of the fit.
    """
    found = []
    for row in rows:
        trial, load = laxity.protocol.trials[row.trial], load_words(laxity.protocol, row.trial)
        # How far off the worst values of a trial are, in words and as values.
        worst = zip(row.coordinates.tolist(), row.off.tolist(), row.times.tolist(), strict=True)
        clear = [x for k, x in enumerate(worst) if k == 0 or x[2] > LISTED][:MOST_LISTED]
        differences: list[str] = []
        values: dict[str, object] = {}
        for k, off, times in clear:
            words, _, unit = COORDINATES[k].replace("internal", "internal_rotation").rpartition("_")
            size = f"{abs(off):.2g} {unit} {'larger' if off > 0.0 else 'smaller'}"
            differences.append(f"{words.replace('_', ' ')} is {size} ({times:.2g} times its error)")
            values[f"off_{COORDINATES[k]}"] = off

        chance = f"{row.p_value:.1g}" if row.p_value >= 1e-6 else "less than 1e-06"
        remedy = (
            f"It was left out. Check the trial, and keep it with --keep {trial} if it is right."
            if is_left_out
            else f"Check the trial, and leave it out with --leave-out {trial} if it is wrong."
        )
        sentence = (
            f"{trial} is inconsistent with the other trials: under {load} its "
            f"{listed(differences)} than {AGAINST[code]}. The probability of such an outlier "
            f"among as many trials is {chance}. {remedy}"
        )
        values |= {"load": load, "p_value": row.p_value, "is_left_out": is_left_out}
        if row is rows[-1] and then[0]:
            sentence, values = f"{sentence} {then[0]}", values | {**then[1]}
        found.append(finding(code, trial, values, sentence=sentence))
    return tuple(found)


def _scales(compared: LaxityResiduals, theta: Array) -> Array:
    """Standard deviation of every residual: as stated, or of all residuals in its unit."""
    laxity = compared.laxity
    measured = laxity.is_measured
    if laxity.sd is not None and not np.isnan(laxity.sd[measured]).any():
        return np.array(laxity.sd[measured])
    left = np.abs(compared.residuals(theta))
    scales = np.ones(left.size)
    for kind in np.unique(compared.units):
        own = compared.units == kind
        scales[own] = max(NORMAL * float(np.median(left[own])), LEAST_SCALE)
    return scales
