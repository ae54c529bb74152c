"""Which answers of a folder are out of date, and in what their questions differ."""

from dataclasses import replace
from typing import Any

import pytest
from quick_calls import ALL_BUT_ACL

import identknee as ik
from identknee.calibrate.problem import TABLE_TERM, EvidenceTerm
from identknee.report.overview import overview, question_sentences, stale_answers
from identknee.verbs.answer import Answer
from identknee.verbs.fit import FITTED


def _with_deviance(answer: Answer, deviance: float) -> Answer:
    term = EvidenceTerm(name=TABLE_TERM, n=1, deviance=deviance, share=1.0)
    return replace(answer, evidence=(term,))


@pytest.fixture(scope="module")
def answers() -> tuple[ik.Calibration, ik.Profiles]:
    """A fit and a profile of the same question."""
    knee = ik.reference_knee()
    clean = ik.simulate(knee, "drawer").laxity
    laxity = ik.add_noise(clean, sd_mm=0.5, sd_deg=0.5, seed=1)
    how: Any = {"noise": "0.5mm,0.5deg", "fixed": ALL_BUT_ACL}
    return (
        ik.fit(knee, laxity, more_starts=0, **how),
        ik.profile(knee, laxity, parameters=["ACL.stiffness_kN"], **how),
    )


def test_a_lower_optimum_puts_an_answer_out_of_date(
    answers: tuple[ik.Calibration, ik.Profiles],
) -> None:
    fitted, profiles = answers
    assert fitted.best_deviance == pytest.approx(profiles.deviance, abs=1e-6)
    assert stale_answers(answers) == {}
    lower = _with_deviance(fitted, profiles.deviance - 1.0)
    assert stale_answers([lower, profiles]) == {1: lower}
    assert list(stale_answers([fitted, _with_deviance(profiles, 1.0)])) == [0]
    # Two fits alone are compared as fits from several starts.
    assert stale_answers([fitted, lower]) == {}
    (said,) = overview([lower, profiles]).questions
    assert f"{lower.best_deviance:.4g}" in said
    # Run again as before it would end where it did.
    assert f"{FITTED}/fitted.toml" in said


def test_answers_to_other_questions_are_not_compared(
    answers: tuple[ik.Calibration, ik.Profiles],
) -> None:
    fitted, profiles = answers
    assert profiles.question is not None
    other = replace(profiles, question=replace(profiles.question, priors=True))
    assert stale_answers([_with_deviance(fitted, 0.0), other]) == {}
    (said,) = question_sentences([fitted, other])
    assert "priors" in said
    assert list(question_sentences(answers)) == []
