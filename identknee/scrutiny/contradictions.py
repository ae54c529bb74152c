"""What is said of trials that the others contradict, and what the fit is without them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import Scaled, restricted, typical_steps
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.laxity.trial_words import load_words
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array
from identknee.runs.findings import Finding, Severity
from identknee.runs.words import amount, label_without_unit, listed, unit_of
from identknee.scrutiny.end_points import suspicious_end_points
from identknee.scrutiny.suspicious_rows import SuspiciousRow, left_out, suspicious_rows

# Values of a trial are told from this many standard errors on, and this many of them at most.
TOLD, MOST_TOLD = 3.0, 3
BUDGET = 80
# Part of a parameter's range, and typical steps: at a bound, and a change worth telling.
AT_END, WORTH = 1e-6, 0.1
# Of a normal error to its median size.
NORMAL = 1.4826


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
    part = restricted(Scaled(problem=compared, sd=_scales(compared, theta)), fixed, theta)
    begin = part.free.restrict(theta)
    end = part.free.expand(fit(part, begin, method="least-squares", budget=BUDGET).theta)
    before = LaxityResiduals(model=model, laxity=laxity).differences(theta)
    after = compared.differences(end)
    falls = [
        f"from {_root_mean(before[:, x]):.3g} to {_root_mean(after[:, x]):.3g} {unit}"
        for x, unit in ((TRANSLATIONS, "mm"), (ROTATIONS, "deg"))
        if np.isfinite(after[:, x]).any()
    ]
    moved = np.abs(end - theta) / typical_steps(model.parameters)
    k = int(np.argmax(moved))
    name = model.parameters.names[k]
    change = (
        f", and the {label_without_unit(name)} changes from {amount(theta[k], '')} to "
        f"{amount(end[k], unit_of(name))}"
        if moved[k] > WORTH
        else ""
    )
    it = "it" if len(rows) == 1 else "these trials"
    without = f"Without {it} the error of the fit goes {' and '.join(falls)}{change}."
    found = list(told(rows, laxity, "what the fit to the other trials says"))
    last = replace(found[-1], sentence=f"{found[-1].sentence} {without}")
    return (*found[:-1], last)


def end_point_findings(laxity: Laxity) -> tuple[Finding, ...]:
    """The trials that the table alone contradicts, for where no model can be asked."""
    rows = suspicious_end_points(laxity)
    return told(rows, laxity, "the course of the other trials over flexion")


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
    jacobian = compared.jacobian(theta)[:, _free(model, theta, fixed)]
    columns = compared.weighted(_each_value(laxity))
    whiten = np.ones(left.size) if is_stated else 1.0 / _scales(compared, theta)
    fitted = left_out(-left * whiten, jacobian * whiten[:, None], columns * whiten[:, None])
    return suspicious_rows(fitted, *np.nonzero(laxity.is_measured))


def without_rows(laxity: Laxity, rows: Iterable[SuspiciousRow]) -> Laxity:
    """The same laxity with these trials left blank."""
    coordinates = np.array(laxity.coordinates)
    coordinates[[x.trial for x in rows]] = np.nan
    return replace(laxity, coordinates=coordinates)


def told(rows: Iterable[SuspiciousRow], laxity: Laxity, against: str) -> tuple[Finding, ...]:
    """Suspicious rows as findings, the trial's name as where.

    Parameters
    ----------
    rows
        What was found.
    laxity
        The data.
    against
        What contradicts them, as the object of "off".
    """
    return tuple(
        Finding(
            severity=Severity.WARNING,
            sentence=_sentence(x, laxity, against),
            where=laxity.protocol.trials[x.trial],
        )
        for x in rows
    )


def _sentence(row: SuspiciousRow, laxity: Laxity, against: str) -> str:
    values = list(zip(row.coordinates.tolist(), row.off.tolist(), row.times.tolist(), strict=True))
    clear = [x for k, x in enumerate(values) if k == 0 or x[2] > TOLD][:MOST_TOLD]
    said = []
    for k, off, times in clear:
        words, _, unit = COORDINATES[k].replace("internal", "internal_rotation").rpartition("_")
        size = f"{abs(off):.2g} {unit} {'larger' if off > 0.0 else 'smaller'}"
        said.append(f"{words.replace('_', ' ')} is {size} ({times:.2g} times its error)")
    trial, load = laxity.protocol.trials[row.trial], load_words(laxity.protocol, row.trial)
    chance = f"{row.p_value:.1g}" if row.p_value >= 1e-6 else "less than 1e-06"
    return (
        f"{trial} does not agree with the other trials: under {load} "
        f"its {listed(said)} than {against}. In as many trials, chance alone puts one as far "
        f"off with probability {chance}. Check the trial, and leave its cells blank if it is wrong."
    )


def _free(model: LaxityModel, theta: Array, fixed: Sequence[str]) -> list[int]:
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


def _each_value(laxity: Laxity) -> Array:
    """A unit error in each measured value alone, shape ``(n, 5, m)``."""
    trials, coordinates = np.nonzero(laxity.is_measured)
    errors = np.zeros((*laxity.coordinates.shape, trials.size))
    errors[trials, coordinates, np.arange(trials.size)] = 1.0
    return errors


def _root_mean(values: Array) -> float:
    known = values[~np.isnan(values)]
    return float(np.sqrt((known**2).mean())) if known.size else float("nan")
