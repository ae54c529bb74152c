"""Checks of a laxity table: loads, frames, conventions, and trials that contradict the others."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_array, diags_array
from scipy.special import chdtrc, fdtrc

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import WhitenedResiduals, restricted, typical_steps
from identknee.laxity.protocol import (
    ABSOLUTE,
    FLEXION,
    LOADS,
    Protocol,
    dominant_loads,
    opposite_pairs,
    unloaded_trials,
)
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.laxity.translations import COMPONENTS, DEFINITIONS, Translations, to_components
from identknee.laxity.trial_words import load_words
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import array, declared, entry
from identknee.runs.findings import Finding, finding
from identknee.runs.words import amount, label_without_unit, listed, unit_of

# A misfit that noise alone would leave less often than this is doubtful, and one that is so many
# times what noise leaves (three times its standard deviation) speaks of a mistake in the data.
IMPROBABLE, GROSS = 1e-3, 9.0
# Twice what simple laxity devices leave against a robot, about 1 mm and 2.5 deg.
MOST_MM, MOST_DEG = 2.0, 5.0
# Share of its length in the scan below which a ligament is too short in half of the trials; one may
# be, as the posterior capsule in deep flexion, and not half of all.
SHORT = 0.75
# The coordinate on which each load works.
WORKS_ON = (
    "internal_deg",
    "varus_deg",
    "anterior_drawer_mm",
    "distraction_mm",
    "lateral_shift_mm",
)
# What opposite loads move a knee by at the least for their sign to be beyond doubt [mm, deg].
LEAST = 2.0


def load_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """That no trial has a load, as where the columns of loads were left out."""
    return () if laxity.protocol.loads.any() else (finding("no-loads", "data"),)


def frame_findings(model: LaxityModel) -> tuple[Finding, ...]:
    """That the measured poses put the insertions of half the ligaments far too close together."""
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
    """The columns in which opposite loads move the tibia the wrong way, from the table alone.

    A load moves the tibia its own way wherever equilibrium is stable. Only columns are named in
    which most pairs of opposite loads move it the other way, and by more than any stray load or
    noise explains.
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


# How often a clean table may be accused, shared by looks at whole trials and at single values.
LEVEL = 0.01
# Share of the trials that may be blunders; where more stand out it is the model that is wrong.
MOST_SHARE = 0.1
# Relative size below which a residual or singular value is rounding and judges nothing.
LEAST_LEFT = 1e-6
# Mean square in units of the noise below which data are free of noise, and rounding is left.
LEAST_SQUARE = 1e-6
# Fewest trials of one load direction that show how coordinates change with flexion.
LEAST_TRIALS = 4
# How often a table may be accused for which the courses are right; they are nearly so, not quite.
TABLE_LEVEL = 1e-4
# Loads of one direction may differ by this share of them and still be one end point.
ALIKE = 0.25
# A sentence lists values of a trial from this many standard errors on, and so many at most.
LISTED, MOST_LISTED = 3.0, 3
BUDGET = 80
# Part of a parameter's range that counts as at a bound; typical steps that count as a change.
AT_END, WORTH = 1e-6, 0.1
# Standard deviation of a normal error over its median absolute size.
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
    parameter for each value left out this is exact for a linear model. The inner products of
    what is left of the columns are ``own - explained' explained``; no matrix is as large as the
    number of values squared.
    """

    own: Any = entry("Inner products of the columns themselves, sparse, shape ``(k, k)``")
    explained: Array = array(
        "Parts of the columns that the parameters, and values left out, make up for",
        *("direction", "value"),
    )
    left: Array = array("Inner products of what is left with the columns", "value")
    square: float = entry("Sum of squares of what is left", unit="1")
    degrees: int = entry("Degrees of freedom of it", unit="1")

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
        inverse = _inverse(self._blocks(chosen) * (is_used[:, :, None] & is_used[:, None, :]))
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


def _inverse(blocks: Array) -> Array:
    """Pseudo-inverses of matrices of inner products, which may be linearly dependent."""
    return np.asarray(np.linalg.pinv(blocks, rcond=LEAST_LEFT, hermitian=True), float)


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
    names, values, is_own = _by_trial(trials)
    if fit.square < LEAST_SQUARE * fit.degrees:
        return found
    while names.size and fit.degrees > len(names) // 2:
        sizes = fit.sizes
        # The values whose change the parameters and trials left out cannot make up for.
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
    """The trials (t,), the values of each (t, w), and which of these places hold one."""
    names, group, count = np.unique(trials, return_inverse=True, return_counts=True)
    order = np.argsort(group, kind="stable")
    values = np.zeros((names.size, count.max(initial=0)), dtype=np.int64)
    is_own = np.arange(values.shape[1]) < count[:, None]
    values[is_own] = order
    return names, values, is_own


def _p_values_of(fit: LeaveOneOut, sizes: Array, values: IntArray, falls: Array) -> Array:
    """Of each trial, as one of all trials and of all values; 1 where nothing can be said."""
    counts = np.isfinite(sizes).sum(axis=1)
    single = (fit.left[values] ** 2 / sizes).max(axis=1)
    by_trial, by_value = _p_values(fit, falls, counts), _p_values(fit, single, np.ones_like(counts))
    both = 2.0 * np.minimum(len(values) * by_trial, len(fit.left) * by_value)
    return np.where((counts == 0) | (fit.degrees <= counts), 1.0, np.minimum(1.0, both))


def _p_values(fit: LeaveOneOut, falls: Array, counts: IntArray) -> Array:
    """Probability of so great a fall of the square by chance if so many values are left out."""
    degrees, k = np.maximum(fit.degrees - counts, 1), np.maximum(counts, 1)
    rest = np.maximum(fit.square - falls, 0.0) / degrees
    is_known = rest > 0.0
    ratio = falls / k / np.where(is_known, rest, 1.0)
    return np.where(is_known, fdtrc(k, degrees, ratio), 1.0)


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
    """The trials that a fit to all others contradicts, and the fit without them."""
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
    # Parameters that could have moved: neither fixed nor at a bound.
    own = model.parameters
    margin = AT_END * (own.upper - own.lower)
    inside = (theta > own.lower + margin) & (theta < own.upper - margin)
    jacobian = compared.jacobian(theta)[
        :, [k for k, name in enumerate(own.names) if inside[k] and name not in fixed]
    ]
    # A unit error in each coordinate of each trial; errors of one trial change no other's rows.
    unit = np.broadcast_to(np.eye(len(COORDINATES)), (laxity.n, *2 * [len(COORDINATES)]))
    columns = columns_by_trial(compared.weighted(unit), laxity.is_measured)
    whiten = np.ones(left.size) if is_stated else 1.0 / _scales(compared, theta)
    fitted = leave_one_out(
        -left * whiten, jacobian * whiten[:, None], diags_array(whiten) @ columns
    )
    return suspicious_rows(fitted, *np.nonzero(laxity.is_measured))


def columns_by_trial(rows: Array, is_measured: BoolArray) -> csr_array:
    """How each measured value enters residuals that depend on those of its trial alone, sparse.

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
    coordinates = np.array(laxity.coordinates)
    coordinates[[x.trial for x in rows]] = np.nan
    return replace(laxity, coordinates=coordinates)


def trial_findings(
    rows: Sequence[SuspiciousRow],
    laxity: Laxity,
    code: str,
    *,
    then: tuple[str, Mapping[str, object]] = ("", {}),
    is_left_out: bool = False,
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
    is_left_out
        Whether the result does not rest on them.
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


def _root_mean(values: Array) -> float:
    known = values[~np.isnan(values)]
    return float(np.sqrt((known**2).mean())) if known.size else float("nan")


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
# Share of the misfit that a convention has to remove, and share of it that the linear model at the
# start has to predict before a fit is made.
REMOVED, PROMISED = 0.9, 0.5
MOST_FITS = 4
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
    translations
        Definition that the translations have; components are what they should be.
    """

    what: str
    order: tuple[int, ...] = tuple(range(len(COLUMNS)))
    factors: tuple[float, ...] = (1.0,) * len(COLUMNS)
    flexion: float = 1.0
    zero: str | None = None
    translations: Translations = COMPONENTS

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
        if self.translations != COMPONENTS:
            if laxity.zero != ABSOLUTE or not laxity.is_measured.all():
                return None
            coordinates = to_components(self.translations, protocol.flexion_deg, coordinates)
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
        sd = laxity.sd
        if sd is not None:
            own = sd[:, order[:n]]
            sd = np.where(own < LEAST_SD, np.abs(factors[:n]) * own, own)
        try:
            return replace(
                laxity,
                protocol=replace(protocol, flexion_deg=flexion, loads=loads),
                coordinates=coordinates,
                sd=sd,
                zero=zero,
            )
        except ValueError:
            return None


def conventions_of(laxity: Laxity) -> tuple[Convention, ...]:
    """The changes that would put right what people get wrong in a table such as this.

    Signs of columns, of whole motions and of all loads; units; the other side of the body; columns
    exchanged; definitions of translations; and what coordinates are counted from.
    """
    return (*_of_columns(), *_of_translations(), *_zeros(laxity))


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
    for name in (*_LENGTHS, *_ANGLES):
        unit, factor = ("m", 1000.0) if name in _LENGTHS else ("radians", 180.0 / np.pi)
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

    All are looked at where a fit would begin, with the linear model and the priors of the
    parameters. Only the few with the largest predicted reduction are fitted. Where the table as it
    is leaves no more than noise, nothing is looked for; trials without equilibrium at the start
    count nowhere.

    Parameters
    ----------
    model, laxity
        The model and the data.
    start
        Where fits begin, in all parameters of the model, shape ``(p,)``.
    fitted
        Parameters fitted to the table as it is, shape ``(p,)``; where None they are sought.
    """
    prediction = model.with_tests(laxity).predict(start, derivatives=False)
    measured = laxity.is_measured.any(axis=1)
    if (prediction.is_converged & measured).sum() < max(LEAST_SHARE * measured.sum(), 1):
        return None
    usable = laxity if prediction.all_converged else _selected(laxity, prediction.is_converged)
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
        """Sum of squares of what the model leaves of this table, in units of its noise."""
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
        left = self.differences(theta)
        return _root_mean(left[:, TRANSLATIONS]), _root_mean(left[:, ROTATIONS])

    def linearised_residuals(self, start: Array) -> Array:
        """Residuals of the model linearised at `start`, with the priors, shape ``(n, 5)``."""
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


def _selected(laxity: Laxity, rows: BoolArray) -> Laxity | None:
    try:
        part = laxity.select(rows)
        if laxity.zero == "unloaded":
            unloaded_trials(part.protocol)
    except ValueError:
        return None
    return part


def _promising(as_is: _Table, start: Array) -> list[tuple[Convention, _Table]]:
    here, found = as_is.linearised_residuals(start), []
    for convention in conventions_of(as_is.laxity):
        changed = convention.applied(as_is.laxity)
        if changed is None:
            continue
        table = _Table(as_is.residuals.model, changed)
        if not table.has_prediction(start):
            continue
        share = table.chi_square_of(table.linearised_residuals(start)) / table.chi_square_of(here)
        if share <= PROMISED:
            found.append((share, convention, table))
    found.sort(key=lambda x: x[0])
    return [(convention, table) for _, convention, table in found[:MOST_FITS]]
