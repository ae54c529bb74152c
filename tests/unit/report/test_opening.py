"""What results open with where their fit is rejected or implausible."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

from bs4 import BeautifulSoup

from identknee.diagnosis.verdict import Verdict
from identknee.report.answers.profile import profile_range
from identknee.report.opening import opening_of
from identknee.report.overview import Tone, overview, ranges_of
from identknee.report.page.page import report_html
from identknee.report.presenter import Source
from identknee.report.printer import short_text
from identknee.report.results import found_results
from identknee.runs.findings import Doubt, Finding, Severity, finding
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.files import load
from identknee.verbs.profile import Profiles

STORED = Path(__file__).parents[2] / "fuzz" / "results"
MISFIT = finding(
    "conditional-on-misfit",
    "data",
    {"n": 45, "deviance": 102.1, "p": 1e-6, "command": "identknee diagnose"},
)
IMPROBABLE = finding("misfit-improbable", "data", {"ratio": 2.0}, sentence="Twice the misfit.")
GROSS = finding("misfit-gross", "data", {"ratio": 10.0}, sentence="Ten times the misfit.")
NOTHING_LESS = finding("no-loads", "data")


def _force(ligament: str, newtons: float) -> Finding:
    values = {
        "ligament": ligament,
        "force_N": newtons,
        "load": "varus",
        "failure_N": 557.0,
        "source": "Wijdicks 2010",
    }
    return finding("implausible-force", ligament, values)


def _profiles(*findings: Finding) -> Profiles:
    answer = load(STORED / "profile")
    assert isinstance(answer, Profiles)
    doubts = {x.kind.doubt for x in findings}
    return replace(
        answer,
        findings=findings,
        parameters={
            name: replace(
                x,
                conditional_on_misfit=Doubt.MISFIT in doubts,
                at_implausible_fit=Doubt.IMPLAUSIBLE in doubts,
            )
            for name, x in answer.parameters.items()
        },
    )


def test_a_sound_fit_opens_with_nothing() -> None:
    assert opening_of([_profiles(NOTHING_LESS)]).sentences == ()
    assert opening_of([_profiles(NOTHING_LESS)]).without([NOTHING_LESS]) == (NOTHING_LESS,)


def test_the_misfit_comes_first_with_the_command_of_the_same_data() -> None:
    answer = _profiles(_force("MCL", 1262.0), MISFIT)
    first, second = opening_of([answer]).sentences
    assert "102.1" in first
    assert answer.record is not None
    settings = answer.record.settings
    assert f"identknee diagnose {settings['subject']} {settings['data']}" in first
    assert "1262 N" in second


def test_an_implausible_fit_ends_with_the_command() -> None:
    forces = (_force("MCL", 1262.0), _force("LCL", 700.0))
    said, command = opening_of([_profiles(*forces)]).sentences
    assert "1262 N" in said
    assert "700 N" in said
    assert "identknee diagnose reference" in command


def _diagnosed(**settings: Any) -> Answer:
    answer = load(STORED / "diagnose")
    assert answer.record is not None
    record = replace(answer.record, settings={**answer.record.settings, **settings})
    return replace(answer, record=record, findings=())


def test_after_a_diagnosis_of_an_implausible_fit_one_with_limits_is_asked_for() -> None:
    implausible, rejected = _profiles(_force("MCL", 1262.0)), _profiles(MISFIT)
    asked = {"noise": "1mm,2deg", "uncertain": ["insertions=2mm"], "leave_out": ["a b", "c"]}
    said = opening_of([implausible, _diagnosed(**asked)]).sentences[-1]
    assert said.startswith("Next: identknee diagnose reference")
    words = shlex.split(said.removeprefix("Next: "))
    options = list(zip(words[-10::2], words[-9::2], strict=True))
    assert options == [
        ("--uncertain", "insertions=2mm"),
        ("--noise", "1mm,2deg"),
        ("--plausible", "default"),
        ("--leave-out", "a b"),
        ("--leave-out", "c"),
    ]
    for answers in (
        [implausible, _diagnosed(plausible="default")],
        [rejected, _diagnosed(plausible=None)],
    ):
        assert not opening_of(answers).has_command


def test_what_was_said_is_not_said_again_but_for_errors() -> None:
    opening = opening_of([_profiles(MISFIT, IMPROBABLE, GROSS)])
    assert opening.without([MISFIT, IMPROBABLE, GROSS, NOTHING_LESS]) == (GROSS, NOTHING_LESS)
    assert opening_of([_profiles(GROSS)]).without([GROSS]) == ()
    assert GROSS.severity is Severity.ERROR


def test_texts_of_an_answer_begin_with_it() -> None:
    answer = _profiles(MISFIT, NOTHING_LESS)
    (first,) = opening_of([answer]).sentences
    assert " ".join(str(answer).split()).startswith(first)
    assert first in " ".join(short_text(answer).splitlines()[1:])
    assert str(answer).count("102.1") == 1
    assert NOTHING_LESS.line in str(answer)


def test_no_status_beside_a_doubt_is_known() -> None:
    sound, rejected, odd = (_profiles(*x) for x in ((), (MISFIT,), (_force("MCL", 1262.0),)))
    for answer, expected in (
        (sound, "known"),
        (rejected, Doubt.MISFIT.value),
        (odd, Doubt.IMPLAUSIBLE.value),
    ):
        (own,) = (profile_range(x).status for x in answer.profiles)
        assert own == expected
        assert {x.status for own in ranges_of([answer]).values() for x in own} == {expected}
    assert overview([sound]).tone is Tone.GOOD
    assert overview([rejected]).tone is overview([odd]).tone is Tone.WRONG
    # Of other methods too, which know nothing of it.
    local = replace(load(STORED / "information"), findings=(MISFIT,))
    statuses = {x.status for own in ranges_of([local]).values() for x in own}
    assert not statuses & {"known", "known locally", "probable"}


def _statuses(*answers: Answer) -> dict[Source, set[str]]:
    found: dict[Source, set[str]] = {}
    for own in ranges_of(answers).values():
        for x in own:
            found.setdefault(x.source, set()).add(x.status)
    return found


def _of_inputs(answer: Answer, **inputs: str) -> Answer:
    assert answer.record is not None
    return replace(answer, record=replace(answer.record, inputs={**answer.record.inputs, **inputs}))


def test_a_diagnosis_that_rejects_the_model_leaves_nothing_known_without_the_cause() -> None:
    """Only a named cause in a model that fits with it is no proviso."""
    named = load(STORED / "diagnose")
    assert isinstance(named, Diagnosis)
    assert named.misfit is not None
    assert named.record is not None
    profiles = _of_inputs(_profiles(), **named.record.inputs)
    statuses = _statuses(named, profiles)
    assert "known" in statuses[Source.CAUSE]
    for source in (Source.DIAGNOSIS, Source.PROFILE):
        assert Doubt.MISFIT.value in statuses[source]
        assert "known" not in statuses[source]
    assert named.doubt_before == Doubt.MISFIT.value
    assert named.doubt_after is None
    ambiguous = replace(named, verdict=Verdict.AMBIGUOUS)
    assert "known" not in _statuses(ambiguous)[Source.CAUSE]
    assert ambiguous.doubt_after == Doubt.CAUSE.value
    assert replace(named, findings=(_force("MCL", 1262.0),)).doubt_after == Doubt.IMPLAUSIBLE.value
    left = replace(named, misfit=replace(named.misfit, p_value_after=0.01))
    assert left.doubt_after == Doubt.MISFIT.value

    adequate = replace(named, verdict=Verdict.ADEQUATE, p_value=0.4, causes=())
    assert adequate.doubt_before is adequate.doubt_after is None
    assert "known" in _statuses(adequate, profiles)[Source.PROFILE]
    assumed = replace(adequate, made_by_priors_before=("ACL.stiffness_kN",))
    (acl,) = ranges_of([assumed])["ACL.stiffness_kN"]
    assert acl.status == "bounded by assumption"
    assert "known" in _statuses(assumed)[Source.DIAGNOSIS]
    odd = replace(adequate, findings=(_force("MCL", 1262.0),))
    assert "known" not in _statuses(odd)[Source.DIAGNOSIS]


def test_a_diagnosis_of_another_knee_says_nothing_of_this_one() -> None:
    diagnosis = load(STORED / "diagnose")
    assert diagnosis.record is not None
    for name in ("subject", "data"):
        other = _of_inputs(_profiles(), **{**diagnosis.record.inputs, name: "another"})
        assert "known" in _statuses(diagnosis, other)[Source.PROFILE]


def test_the_page_opens_with_it() -> None:
    (result,) = found_results(STORED / "profile")
    many = [finding("trial-against-fit", f"T{k}", sentence=f"T{k} is off.") for k in range(6)]
    answer = _profiles(MISFIT, _force("MCL", 1262.0), *many)
    page = BeautifulSoup(report_html([replace(result, answer=answer)]), "html.parser")
    section = page.find(id="answer-1")
    assert section is not None
    paragraphs = [" ".join(x.get_text().split()) for x in section.find_all("p")]
    assert "102.1" in paragraphs[0]
    assert "identknee diagnose reference" in paragraphs[0].replace("\u00a0", " ")
    assert "1262" in paragraphs[1]
    cautions = section.find(class_="cautions")
    assert cautions is not None
    assert "102.1" not in cautions.get_text()
    assert "1262" not in cautions.get_text()
    # The three gravest in all, and a link to the others.
    assert "T0 is off" in cautions.get_text()
    assert "T1 is off" not in cautions.get_text()
    assert "5 more findings" in cautions.get_text()
    link = cautions.find("a")
    assert link is not None
    below = page.find(id=str(link["href"]).removeprefix("#"))
    assert below is not None
    assert all(f"T{k} is off" in below.get_text() for k in range(1, 6))
    assert "T0 is off" not in below.get_text()
