"""What speaks against a diagnosis: contradicted trials, the verdict without them, forces."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identknee.checks.contradicted_trials import (
    SuspiciousRow,
    left_out,
    suspicious_end_points,
    suspicious_rows,
    trial_findings,
    without_rows,
)
from identknee.checks.implausible import implausible_findings
from identknee.checks.subject_checks import rim_findings
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.table import Laxity
from identknee.model.effects.effect import Effect
from identknee.runs.arrays import Array
from identknee.runs.findings import Finding, finding
from identknee.subject.knee import Knee

# Trials in which most misfit is left are named up to this number.
MOST_REPEATED = 3


def rows_of(found: Investigation) -> list[SuspiciousRow]:
    """The trials that the other ones contradict, beside the best explanation of the misfit."""
    fitted = found.explanation.fitted
    rows, jacobian = fitted.residual_rows(), fitted.evaluation.jacobian
    whitened = fitted.noise.whiten(np.eye(fitted.n_data))
    columns = np.vstack([whitened, np.zeros((len(rows) - fitted.n_data, fitted.n_data))])
    measured = fitted.laxity.is_measured
    return suspicious_rows(left_out(rows, jacobian, columns), *np.nonzero(measured))


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """The verdict on other trials than those of a diagnosis.

    Attributes
    ----------
    knee
        The subject.
    starts, effects, seed
        As in `identknee.diagnosis.investigation.investigate`, which is done again.
    """

    knee: Knee
    starts: Sequence[Array]
    effects: Sequence[Effect] | None
    seed: int

    def row_findings(self, found: Investigation) -> tuple[Finding, ...]:
        """The rows that the fit contradicts, with the verdict that the other trials have."""
        rows = rows_of(found)
        if not rows:
            return ()
        it = "it" if len(rows) == 1 else "these trials"
        then = self._verdict(without_rows(found.laxity, rows), found, f"Without {it}")
        return trial_findings(rows, found.laxity, "trial-against-fit", then=then)

    def table_findings(self, found: Investigation, whole: Laxity) -> tuple[Finding, ...]:
        """The rows that the table contradicts, left out of `found`, with the verdict with them."""
        rows = suspicious_end_points(whole)
        if not rows:
            return ()
        it = "it" if len(rows) == 1 else "them"
        then = self._verdict(whole, found, f"The diagnosis leaves {it} out; with {it}")
        return trial_findings(rows, whole, "trial-against-course", then=then)

    def _verdict(
        self, laxity: Laxity, found: Investigation, start: str
    ) -> tuple[str, dict[str, object]]:
        """The verdict on other trials as a sentence, and as values."""
        rest = investigate(
            self.knee, laxity, starts=self.starts, effects=self.effects, seed=self.seed
        )
        if rest is None:
            return f"{start} the data cannot be tested.", {"verdict": Verdict.NOT_TESTABLE.value}
        verdict, causes = rest.conclusion.verdict.value, [x.name for x in rest.causes]
        names = f" ({' and '.join(causes)})" if causes else ""
        still = "still " if rest.conclusion.verdict is found.conclusion.verdict else ""
        why = " ".join(rest.conclusion.reasons)
        values: dict[str, object] = {"verdict": verdict, "causes": causes}
        return f"{start} the verdict is {still}{verdict}{names}. {why}", values


def sound(laxity: Laxity) -> Laxity:
    """The data, cells blank in trials that the table alone contradicts, no model asked."""
    return without_rows(laxity, suspicious_end_points(laxity))


def with_unsound(part: Laxity, laxity: Laxity) -> Laxity:
    """Some trials of the data, and those that the table contradicts."""
    coordinates = np.array(part.coordinates)
    rows = [x.trial for x in suspicious_end_points(laxity)]
    coordinates[rows] = laxity.coordinates[rows]
    return replace(part, coordinates=coordinates)


def implausible_explanation(found: Investigation) -> tuple[Finding, ...]:
    """What the best explanation says of contact, forces and strains that no knee has."""
    fitted = found.explanation.fitted
    model = fitted.compared.model
    prediction = model.predict_once(fitted.theta)
    return (
        *rim_findings(model.protocol.trials, prediction),
        *implausible_findings(model, prediction),
    )


def advice_findings(found: Investigation) -> tuple[Finding, ...]:
    """That no trial can be advised, where some should be, and what to ask for instead."""
    verdict = found.conclusion.verdict
    if found.advice is not None or verdict not in (Verdict.AMBIGUOUS, Verdict.UNEXPLAINED):
        return ()
    if verdict is Verdict.AMBIGUOUS:
        sentence = (
            "No trial to add can be advised: the causes that are left differ in nothing that a "
            "load could show, or the model has no equilibrium in the trials that could be added."
        )
        return (finding("no-trial-advised", "trials", sentence=sentence),)
    # What would help where nothing explains the misfit: repeats, and errors known better.
    fitted, trials = found.explanation.fitted, found.laxity.protocol.trials
    left = np.nansum((fitted.differences / found.noise.sd) ** 2, axis=1)
    worst = [trials[i] for i in np.argsort(-left, kind="stable")[:MOST_REPEATED]]
    values: dict[str, object] = {"trials": worst}
    sentence = (
        "No trial to add can be advised: nothing explains the misfit, so there are no explanations "
        f"that a trial could tell apart. Most of it is left in {', '.join(worst)}: measure these "
        "again, to tell errors of a trial from the knee."
    )
    if fitted.nuisance_groups:
        farthest = min(fitted.nuisance_groups, key=lambda x: x.p_value)
        values["nuisances"] = farthest.name
        sentence += (
            f" Of what is stated as uncertain, the fit moves {farthest.name} to the least probable "
            "place: measure it."
        )
    return (finding("no-trial-advised", "trials", values, sentence=sentence),)
