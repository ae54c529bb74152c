"""What speaks against one fit of a laxity model, before anyone reads its parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identknee.calibrate.doubts import bound_findings, misfit_findings, unstated_misfit_findings
from identknee.calibrate.fit import Fit
from identknee.calibrate.problem import Problem
from identknee.calibrate.second_start import second_search
from identknee.laxity.rmse import LaxityError
from identknee.laxity.table import Laxity
from identknee.model.residuals import LaxityResiduals
from identknee.model.simulate import Simulation
from identknee.model.soundness import rim_findings, stability_findings
from identknee.runs.findings import Finding, Severity
from identknee.runs.outcome import Outcome

# How many trials without equilibrium are listed by name for each reason.
MOST_LISTED = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LostTrial:
    """A measured trial in which the model has no prediction.

    Attributes
    ----------
    trial
        Its name.
    outcome
        How it ended.
    reason
        The same as a sentence, with the share of the load reached.
    """

    trial: str
    outcome: Outcome
    reason: str


def lost_trials(simulation: Simulation, laxity: Laxity) -> tuple[LostTrial, ...]:
    """The measured trials in which a simulation has no equilibrium."""
    rows = zip(
        laxity.protocol.trials,
        simulation.prediction.outcomes,
        simulation.reasons,
        np.any(laxity.is_measured, axis=1).tolist(),
        strict=True,
    )
    return tuple(
        LostTrial(trial=trial, outcome=outcome, reason=reason)
        for trial, outcome, reason, is_measured in rows
        if is_measured and outcome is not Outcome.CONVERGED
    )


def lost_sentences(lost: Sequence[LostTrial]) -> list[str]:
    """Which trials have no equilibrium and why, one sentence for each way in which they ended."""
    by_outcome: dict[Outcome, list[str]] = {}
    for x in lost:
        by_outcome.setdefault(x.outcome, []).append(x.trial)
    sentences = []
    for outcome, trials in by_outcome.items():
        more = len(trials) - MOST_LISTED
        named = ", ".join(trials[:MOST_LISTED]) + (f" and {more} more" if more > 0 else "")
        sentences.append(f"{named}: {outcome.sentence}")
    return sentences


def fit_findings(
    problem: Problem, found: Fit, fitted: Simulation, error: LaxityError, laxity: Laxity
) -> tuple[Finding, ...]:
    """What speaks against a fit.

    Where the misfit is more than noise, or a parameter stands at a bound, a second search begins
    elsewhere, so that a bad start is not taken for bad data.

    Parameters
    ----------
    problem
        What was fitted.
    found, fitted
        The fit, and the laxity simulated with it.
    error
        What it leaves.
    laxity
        The data.
    """
    lost = lost_trials(fitted, laxity)
    if found.outcome is Outcome.START_FAILED:
        return _not_fitted(lost, int(laxity.is_measured.any(axis=1).sum()))
    n_free = found.parameters.n - len(found.fixed)
    if _states_noise(laxity):
        weighted = LaxityResiduals(model=fitted.model, laxity=laxity, weighting="noise")
        residuals = weighted.residuals(found.theta)
        misfit = misfit_findings(float(residuals @ residuals), residuals.size, n_free)
    else:
        misfit = unstated_misfit_findings(error.mm, error.deg)
    bounds = bound_findings(found.theta, found.parameters, found.fixed)
    about_the_knee = (
        *stability_findings(fitted.model),
        *rim_findings(laxity.protocol.trials, fitted.prediction),
    )
    findings = (*misfit, *bounds)
    if all(x.severity is Severity.INFO for x in findings):
        return (*findings, *about_the_knee)
    return (*findings, second_search(problem, found).finding, *about_the_knee)


def _states_noise(laxity: Laxity) -> bool:
    return laxity.sd is not None and not np.isnan(laxity.sd[laxity.is_measured]).any()


def _not_fitted(lost: Sequence[LostTrial], n_measured: int) -> tuple[Finding, ...]:
    said = (
        f"Nothing was fitted: at the start {len(lost)} of {n_measured} measured trials have no "
        "equilibrium. Choose another --start, or leave the cells of such trials blank."
    )
    findings = [Finding(severity=Severity.ERROR, sentence=said, where="starts")]
    findings += [
        Finding(severity=Severity.INFO, sentence=x, where="trials") for x in lost_sentences(lost)
    ]
    return tuple(findings)
