"""What a diagnosis says that comes neither from its causes nor from its misfit."""

from dataclasses import replace

import numpy as np
import pytest
from diagnoses import FRAME, diagnosed

import identknee as ik
from identknee.diagnosis.verdict import Verdict
from identknee.verbs.diagnose import advice_findings


def test_where_nothing_explains_the_misfit_repeats_are_asked_for() -> None:
    found = diagnosed(FRAME)
    conclusion = replace(found.conclusion, verdict=Verdict.UNEXPLAINED)
    unexplained = replace(found, conclusion=conclusion)
    (finding,) = advice_findings(unexplained)
    assert finding.code == "no-trial-advised"
    left = np.nansum((found.base.fitted.differences / found.noise.sd) ** 2, axis=1)
    worst = found.laxity.protocol.trials[int(np.argmax(left))]
    assert finding.values["trials"][0] == worst
    # Nothing is stated to be uncertain there.
    assert "nuisances" not in finding.values
    assert advice_findings(found) == ()


def test_trials_are_advised_once_and_only_where_they_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(
        "identknee.diagnosis.investigation.advise", lambda *given: asked.append(given)
    )
    found = diagnosed(FRAME)
    ambiguous = replace(found, conclusion=replace(found.conclusion, verdict=Verdict.AMBIGUOUS))
    assert ambiguous.explanation.names
    assert not asked
    assert (ambiguous.advice, ambiguous.advice) == (None, None)
    assert len(asked) == 1


def test_values_that_the_parameters_can_always_fit_are_not_testable() -> None:
    knee = ik.example("s192803_bundles")
    exact = ik.simulate(knee).laxity
    one, two = (ik.diagnose(knee, exact.select(x), noise="0.3mm,0.3deg") for x in ([3], [3, 5]))
    assert one.verdict is Verdict.NOT_TESTABLE
    assert one.p_value is None
    assert two.verdict is Verdict.ADEQUATE
