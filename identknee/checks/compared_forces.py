"""Measured forces beside those that a fit predicts."""

import numpy as np

from identknee.calibrate.problem import Problem, SumOfTerms, innermost
from identknee.laxity.forces import RESULTANT, WRENCH
from identknee.model.force_residuals import ForceResiduals, SuperpositionResiduals
from identknee.runs.declare import OF_QUANTITY, Array, array, declared, entry


@declared
class ComparedForces:
    """Forces that were measured in trials, and their predictions by a model."""

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
            measured, values, sd = term.forces.is_measured, term.forces.values, term.forces.sd
            of_row = term.model.protocol.trials
            labels = [term.forces.names] * len(of_row)
        elif isinstance(term, SuperpositionResiduals):
            made, sd = term.superposition, term.sd
            measured, values, of_row = made.is_measured, made.values, made.trials
            labels = [tuple(f"{cut}.{x}" for x in (*WRENCH, RESULTANT)) for cut in made.cut]
        else:
            continue
        places = np.argwhere(measured).tolist()
        names += [labels[i][k] for i, k in places]
        trials += [of_row[i] for i, _ in places]
        columns.append(np.array([x[measured] for x in (values, sd, term.predicted(theta))]))
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
