"""What speaks against a diagnosis itself: fits, bounds, causes not tested, an unstable knee."""

from identknee.calibrate.doubts import bound_findings
from identknee.diagnosis.causes import explanation_of
from identknee.diagnosis.diagnose import Diagnosis
from identknee.diagnosis.refit import Refit
from identknee.model.soundness import stability_findings
from identknee.runs.findings import Finding, Severity
from identknee.runs.outcome import Outcome

# Of the deviance: what a fit that ended before its minimum may promise and still be taken for it.
LEAST_PROMISE = 1.0


def own_findings(found: Diagnosis) -> tuple[Finding, ...]:
    """What a reader of a diagnosis must know of the fits that it stands on."""
    explanation = explanation_of(found)
    findings = list(_unfinished(found.base, "without causes"))
    if explanation is not found.base:
        findings += _unfinished(explanation, f"with {' and '.join(explanation.names)}")
    fitted = explanation.fitted
    findings += bound_findings(fitted.theta, fitted.model.parameters)
    findings += [
        Finding(
            severity=Severity.WARNING if x.could_matter else Severity.INFO,
            sentence=x.reason,
            where=" and ".join(x.refit.names),
        )
        for x in found.attribution.rivals
        if x.reason
    ]
    return (*findings, *stability_findings(found.base.fitted.model))


def _unfinished(refit: Refit, which: str) -> list[Finding]:
    fitted = refit.fitted
    if fitted.outcome is Outcome.MINIMUM or refit.promised_fall < LEAST_PROMISE:
        return []
    sentence = (
        f"The fit {which} did not reach its minimum, and a straight model promises a misfit lower "
        f"by {refit.promised_fall:.2g}: {fitted.outcome.sentence} Begin it elsewhere with --start."
    )
    return [Finding(severity=Severity.WARNING, sentence=sentence, where="starts")]
