"""Measured forces beside those that a fit predicts."""

import numpy as np

from identknee.calibrate.problem import Problem, SumOfTerms, innermost
from identknee.laxity.forces import RESULTANT, WRENCH
from identknee.model.force_residuals import ForceResiduals, SuperpositionResiduals
from identknee.runs.declare import OF_QUANTITY, Array, array, declared, entry


@declared
class ComparedForces:
    """Forces that were measured in trials, and what a model has for them."""

    names: tuple[str, ...] = entry(
        "What was measured, such as `ACL.tension_N`, `contact.medial_N` or, of a replayed path, "
        "`ACL.force_x_N` and `ACL.insitu_N`",
    )
    trials: tuple[str, ...] = entry("Trial of each")
    measured: Array = array("Values measured", "force_value", unit=OF_QUANTITY)
    sd: Array = array(
        "Standard deviation of their errors, those of a replayed pose included",
        "force_value",
        unit=OF_QUANTITY,
    )
    predicted: Array = array("Values at the fit", "force_value", unit=OF_QUANTITY)


def compared_forces(problem: Problem, theta: Array) -> ComparedForces | None:
    """The forces of a problem at theta; None where none was measured."""
    whole = innermost(problem)
    terms = whole.terms.values() if isinstance(whole, SumOfTerms) else ()
    names: list[str] = []
    trials: list[str] = []
    columns = [np.zeros((3, 0))]
    for term in terms:
        if isinstance(term, ForceResiduals):
            made, predicted, sd = term.forces, term.predicted(theta), term.forces.sd
            of_trials = term.model.protocol.trials
            measured = made.is_measured
            for i, k in np.argwhere(measured).tolist():
                names.append(made.names[k])
                trials.append(of_trials[i])
            columns.append(np.array([x[measured] for x in (made.values, sd, predicted)]))
        elif isinstance(term, SuperpositionResiduals):
            replayed, predicted, sd = term.superposition, term.predicted(theta), term.sd
            measured = replayed.is_measured
            for i, k in np.argwhere(measured).tolist():
                names.append(f"{replayed.cut[i]}.{(*WRENCH, RESULTANT)[k]}")
                trials.append(replayed.trials[i])
            columns.append(np.array([x[measured] for x in (replayed.values, sd, predicted)]))
    if not names:
        return None
    values, sds, predictions = np.hstack(columns)
    return ComparedForces(
        names=tuple(names),
        trials=tuple(trials),
        measured=values,
        sd=sds,
        predicted=predictions,
    )
