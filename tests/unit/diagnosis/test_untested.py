"""A cause whose fit failed is not excluded: it is not tested, and no other is then named alone."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnoses import FRAME, diagnosed

from identknee.calibrate.problem import Evaluation
from identknee.checks import subject_checks
from identknee.diagnosis import fitting as refit_module
from identknee.diagnosis import verdict as attribution_module
from identknee.diagnosis.fitting import Refit, RivalState, refit, rivals_of
from identknee.diagnosis.score import LEVEL
from identknee.diagnosis.verdict import (
    SEVERAL,
    UNTESTED,
    Attribution,
    AttributionStep,
    Conclusion,
    Verdict,
    attribute,
    conclude,
    refit_top_candidates,
)
from identknee.model.effects.effect import Effect
from identknee.model.effects.facts import cause_label
from identknee.model.effects.library import effect_named
from identknee.report.presenter import statements_of
from identknee.runs.declare import Array
from identknee.runs.findings import Severity
from identknee.runs.record import Outcome
from identknee.verbs.diagnosis import diagnosis_of

OTHERS = ("shank_gravity", "compression")


def failed(found: Refit) -> Refit:
    """The same refit as it is without a prediction at any start."""
    constrained = found.fitted.constrained
    at = constrained.evaluation
    nothing = Evaluation(
        theta=at.theta, residuals=np.full(1, np.inf), jacobian=np.full((1, at.theta.size), np.nan)
    )
    ended = replace(constrained, evaluation=nothing, outcome=Outcome.START_FAILED)
    return replace(found, fitted=replace(found.fitted, constrained=ended))


def ended(found: Refit, outcome: Outcome) -> Refit:
    """The same refit, its search ended otherwise."""
    constrained = replace(found.fitted.constrained, outcome=outcome)
    return replace(found, fitted=replace(found.fitted, constrained=constrained))


def reconsidered(attribution: Attribution, others: Sequence[Refit]) -> Attribution:
    """The attribution with other refits beside its best."""
    looks = [(x.at, x.scores) for x in attribution.steps]
    return replace(attribution, rivals=rivals_of(attribution.best, others, looks))


def concluded(others: Sequence[Refit]) -> tuple[Attribution, Conclusion]:
    """The verdict on the data with a turned frame, were these the only other refits."""
    found = diagnosed(FRAME)
    attribution = reconsidered(found.attribution, others)
    return attribution, conclude(attribution, found.conclusion.p_value)


@pytest.fixture(scope="module")
def others() -> tuple[Refit, ...]:
    """The refits beside that of the turned frame."""
    return tuple(x.refit for x in diagnosed(FRAME).attribution.rivals)


def scores_of(found: Attribution) -> dict[str, float]:
    """Share of the highest score that each cause has, for those that chance does not explain."""
    scores = found.steps[0].scores
    return {x.name: x.score / scores.max_score for x in scores.candidates if x.p_value <= LEVEL}


def strong_and_weak(others: Sequence[Refit]) -> tuple[Refit, Refit]:
    """A refit of a cause that scores high, and one of a cause that does not."""
    shares = scores_of(diagnosed(FRAME).attribution)
    single = [x for x in others if len(x.causes) == 1]
    ranked = sorted(single, key=lambda x: -shares.get(x.names[0], 0.0))
    assert shares[ranked[0].names[0]] >= 0.5
    assert shares.get(ranked[-1].names[0], 0.0) < 0.5
    return ranked[0], ranked[-1]


def test_a_failed_refit_is_not_excluded_and_blocks_the_name(others: tuple[Refit, ...]) -> None:
    strong, _ = strong_and_weak(others)
    # Alone beside it, the frame is named.
    _, named = concluded([])
    assert named.verdict is Verdict.NAMED
    attribution, doubted = concluded([failed(strong)])
    (rival,) = attribution.rivals
    assert (rival.state, rival.is_excluded) == (RivalState.NOT_TESTED, False)
    assert attribution.untested_rivals == (rival,)
    assert doubted.verdict is Verdict.AMBIGUOUS
    assert doubted.group == (FRAME,)
    assert "a doubt" in doubted.sentence
    label = cause_label(strong.names[0])
    assert any(x.startswith(f"The {label} could not") for x in doubted.reasons)


def test_a_cause_with_a_low_score_blocks_nothing(others: tuple[Refit, ...]) -> None:
    _, weak = strong_and_weak(others)
    attribution, conclusion = concluded([failed(weak)])
    (rival,) = attribution.rivals
    assert rival.state is RivalState.NOT_TESTED
    assert not rival.could_matter
    assert rival.reason
    assert conclusion.verdict is Verdict.NAMED


def test_an_unfinished_fit_is_excluded_only_if_its_promise_would_not_help(
    others: tuple[Refit, ...],
) -> None:
    strong, _ = strong_and_weak(others)
    (rival,) = concluded([strong])[0].rivals
    assert rival.state is RivalState.EXCLUDED
    # At its minimum it promises nothing more, whatever the search says of its end.
    (stuck,) = concluded([ended(strong, Outcome.CLIFF)])[0].rivals
    assert stuck.refit.predicted_reduction < 1e-2
    assert stuck.state is RivalState.EXCLUDED
    # Where it began the linear model predicts most of what the fit then gained.
    fitted = strong.fitted
    start = fitted.theta.copy()
    start[-strong.causes[-1].parameters.n :] *= 0.5
    begun = refit(diagnosed(FRAME).base, strong.causes, [start], most_steps=1)
    gained = begun.fitted.deviance - fitted.deviance
    assert begun.predicted_reduction == pytest.approx(gained, rel=0.5)
    cut = ended(begun, Outcome.CLIFF)
    deficit = diagnosed(FRAME).attribution.best.log_evidence - cut.log_evidence
    (rival,) = concluded([cut])[0].rivals
    is_open = deficit - 0.5 * cut.predicted_reduction <= 10.0
    expected = RivalState.NOT_TESTED if is_open else RivalState.EXCLUDED
    assert rival.state is expected


class Blocked:
    """Refits of one cause fail from every start with more of it, but go on where one succeeded."""

    def __init__(self, name: str, most: float) -> None:
        self._name, self._most = name, most
        self.n_failed = 0
        self._reached: list[Array] = []

    def __call__(
        self, base: Refit, causes: Sequence[Effect], starts: Sequence[Array], **steps: Any
    ) -> Refit:
        found = refit(base, causes, starts, **steps)
        size = np.abs(starts[0][-causes[-1].parameters.n :]).max()
        goes_on = any(x is starts[0] for x in self._reached)
        if causes[-1].name == self._name and size > self._most and not goes_on:
            self.n_failed += 1
            return failed(found)
        self._reached.append(found.fitted.theta)
        return found


def first_step(names: Sequence[str]) -> tuple[AttributionStep, Refit]:
    """The first look at the data with a turned frame, of these effects alone."""
    found = diagnosed(FRAME)
    knee = found.base.fitted.model.knee
    effects = [effect_named(knee, x) for x in names]
    return attribute(found.base, effects, seed=0).steps[0], found.base


def test_a_refit_that_fails_begins_with_less_of_the_effect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    step, base = first_step([FRAME])
    (free,) = step.refits
    largest = np.abs(free.amplitudes(FRAME)).max()
    blocked = Blocked(FRAME, 0.05 * largest)
    monkeypatch.setattr(attribution_module, "refit", blocked)
    (found,) = refit_top_candidates(replace(step, refits=()), base)
    assert blocked.n_failed >= 4
    assert found.log_evidence == pytest.approx(free.log_evidence, abs=0.01)


@pytest.mark.slow
def test_what_fails_from_everywhere_is_said_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    found = diagnosed(FRAME)
    blocked = Blocked(FRAME, -1.0)
    monkeypatch.setattr(attribution_module, "refit", blocked)
    monkeypatch.setattr(refit_module, "refit", blocked)
    knee = found.base.fitted.model.knee
    effects = [effect_named(knee, x) for x in (FRAME, *OTHERS)]
    attribution = attribute(found.base, effects, seed=0)
    conclusion = conclude(attribution, found.conclusion.p_value)
    assert any(FRAME in x.refit.names for x in attribution.untested_rivals)
    assert conclusion.verdict in (Verdict.AMBIGUOUS, Verdict.UNEXPLAINED)
    assert conclusion.sentence not in (SEVERAL, Verdict.UNEXPLAINED.sentence)
    if conclusion.verdict is Verdict.UNEXPLAINED:
        assert conclusion.sentence == UNTESTED
    whole = replace(found, attribution=attribution, conclusion=conclusion)
    answer = diagnosis_of(whole)
    entries = [x for x in answer.rivals if FRAME in x.causes]
    assert {x.state for x in entries} == {RivalState.NOT_TESTED}
    assert not any(x.is_excluded for x in entries)
    assert {x.log_evidence_deficit for x in entries} == {None}
    reason = "could not be tested"
    assert all(cause_label(FRAME) in str(x.reason) and reason in str(x.reason) for x in entries)
    assert any(cause_label(FRAME) in x and reason in x for x in answer.reasons)
    first, *_ = statements_of(answer)
    assert reason in first.sentence


def test_the_diagnosis_says_what_its_fits_lack(others: tuple[Refit, ...]) -> None:
    strong, weak = strong_and_weak(others)
    found = diagnosed(FRAME)
    attribution, conclusion = concluded([failed(strong), failed(weak)])
    whole = replace(found, attribution=attribution, conclusion=conclusion)
    said = {x.where: x.severity for x in whole.findings}
    assert said[strong.names[0]] is Severity.WARNING
    assert said[weak.names[0]] is Severity.INFO
    assert "starts" not in said
    # A base fit that was stopped on its way down.
    base = found.base.fitted
    n = base.model.n_ligament_parameters
    away = base.theta.copy()
    away[:n] *= 1.3
    begun = refit(found.base, [], [away], most_steps=1)
    assert begun.fitted.outcome is not Outcome.MINIMUM
    (warning,) = [x for x in replace(found, base=begun).findings if x.where == "starts"]
    assert (warning.code, warning.severity) == ("fit-unfinished", Severity.WARNING)
    assert warning.values["explanation"] == []


def test_a_diagnosis_carries_the_failed_stability_check_of_its_subject(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = diagnosed(FRAME)
    assert [x for x in found.findings if x.where == "subject"] == []
    monkeypatch.setattr(subject_checks, "ENOUGH_MARGIN", np.inf)
    again = replace(found)
    (finding,) = [x for x in again.findings if x.where == "subject"]
    assert finding.code == "hardly-stable-subject"
