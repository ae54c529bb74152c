"""All checks of a fit in one pass: the table, the misfit, bounds, starts, the model at the fit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from identknee.checks.contradicted_trials import end_point_findings, row_findings
from identknee.checks.conventions import convention_findings
from identknee.checks.data_checks import frame_findings, load_findings, load_sign_findings
from identknee.checks.fit_warnings import AlternativeFit
from identknee.checks.plausibility import implausible_findings
from identknee.checks.subject_checks import rim_findings, stability_findings
from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel, Prediction
from identknee.runs.arrays import Array
from identknee.runs.findings import Finding, Severity, without_repeats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """A fit to be checked.

    Attributes
    ----------
    model
        The model of the data.
    laxity, table
        The data that the fit rests on, and the whole table with the trials that it does not.
    start, prediction
        Parameters of the model where the search began, shape ``(p,)``, and the prediction of the
        model where it ended.
    held
        Names of parameters that were not asked for: fixed ones and nuisances.
    misfit
        What was found of the misfit and of active bounds.
    """

    model: LaxityModel
    laxity: Laxity
    table: Laxity
    start: Array
    prediction: Prediction
    held: Sequence[str]
    misfit: tuple[Finding, ...]


def check_fit(
    fitted: Fitted,
    others: Sequence[Finding] = (),
    *,
    second: Callable[[], AlternativeFit] | None = None,
) -> tuple[Finding, ...]:
    """What speaks against a fit, the gravest first.

    Where the misfit is more than noise, or a bound is active, conventions of the table are looked
    at first: a broken one explains trials that contradict one another, which are then not listed.
    Where none is broken, a second search tells a bad start from bad data.

    Parameters
    ----------
    fitted
        The fit.
    others
        What else was found, such as trials lost and starts that disagree.
    second
        Makes the second search; None where the fit is the best of several already.
    """
    model, laxity, theta = fitted.model, fitted.laxity, fitted.prediction.theta
    found = [*others, *fitted.misfit, *check_model(model, fitted.prediction)]
    table = table_findings(model, fitted.table)
    is_doubtful = any(x.severity is not Severity.INFO for x in fitted.misfit)
    if is_doubtful:
        if conventions := convention_findings(model, laxity, fitted.start, theta):
            return without_repeats((*conventions, *table, *found))
        if second is not None:
            search = second()
            # What an end that is not the best leaves says nothing of data and model.
            found = [x for x in found if not search.is_better or x not in fitted.misfit]
            found.append(search.finding)
    rows = row_findings(model, laxity, theta, fixed=fitted.held)
    return without_repeats((*table, *trials_by_table(model, fitted.table, rows), *rows, *found))


def check_unfitted(
    model: LaxityModel, laxity: Laxity, others: Sequence[Finding]
) -> tuple[Finding, ...]:
    """What the table alone says where no fit could begin, beside what else was found."""
    trials = end_point_findings(laxity)
    signs = load_sign_findings(laxity)
    return without_repeats((*signs, *table_findings(model, laxity), *trials, *others))


def check_model(model: LaxityModel, prediction: Prediction) -> tuple[Finding, ...]:
    """What speaks against the model at a fit: stability, rims, forces that no knee has."""
    return (
        *stability_findings(model),
        *rim_findings(model.protocol.trials, prediction),
        *implausible_findings(model, prediction),
    )


def table_findings(model: LaxityModel, laxity: Laxity) -> tuple[Finding, ...]:
    """What is wrong with the whole table; of frames and signs where fits begin at its poses."""
    if model.poses is None:
        return load_findings(laxity)
    return (*frame_findings(model), *load_sign_findings(laxity), *load_findings(laxity))


def trials_by_table(
    model: LaxityModel, laxity: Laxity, rows: Sequence[Finding]
) -> tuple[Finding, ...]:
    """Trials that the table alone contradicts where fits begin at its poses, without `rows`."""
    if model.poses is None:
        return ()
    named = {x.where for x in rows}
    return tuple(x for x in end_point_findings(laxity) if x.where not in named)
