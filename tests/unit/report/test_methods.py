"""The paragraph on methods says what the record says, and nothing else."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from report_folders import straight_profiles

import identknee as ik
from identknee.report.methods import given_options
from identknee.runs.files import plain
from identknee.runs.schema import summary_of
from identknee.runs.words import parameter_words
from identknee.verbs.answer import Answer, Question
from identknee.verbs.registry import verbs

RESULTS = Path(__file__).parents[2] / "fuzz" / "results"
VERBS = sorted(x.name for x in RESULTS.iterdir() if x.name != "check")
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?!\w)")
# Numbers of the words alone: of units, of the chance, of typical steps.
OWN = {"1", "5", "95", "2", "3", "256"}
ASKED = Question(
    trials=("a", "b"),
    left_out_by_name=(),
    contradicted=(),
    weighting="unit",
    noise_mm=None,
    noise_deg=None,
    priors=False,
    fixed=(),
    bounds={},
    uncertainty={},
)


def changed(answer: Answer, question: dict[str, Any] | None = None, **settings: Any) -> str:
    """The paragraph after a change of what the record says."""
    assert answer.record is not None
    record = replace(answer.record, settings={**answer.record.settings, **settings})
    # The stored results are of a version that did not keep the question.
    asked = replace(answer.question or ASKED, **(question or {}))
    return replace(answer, record=record, question=asked).methods()


def said(answer: Answer) -> str:
    """The paragraph without its references."""
    return answer.methods().partition("\n\nReferences: ")[0]


def new(answer: Answer, after: str) -> str:
    """The sentences that a change of what the answer's record says brought."""
    before, own = (re.split(r"(?<=\.) ", x.partition("\n\n")[0]) for x in (changed(answer), after))
    return " ".join(x for x in own if x not in before)


@pytest.mark.parametrize("verb", VERBS)
def test_every_number_is_one_of_the_result(verb: str) -> None:
    answer = ik.load(RESULTS / verb)
    whole = json.dumps(plain(summary_of(answer)))
    known = {float(x) for x in re.findall(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", whole)}
    known |= {100.0 * x for x in known} | {float(len(answer.trials_used))}
    known |= {float(len(x)) for x in summary_of(answer).values() if isinstance(x, list | dict)}
    for number in NUMBER.findall(said(answer)):
        value = float(number)
        is_there = any(abs(value - x) <= 0.01 * abs(x) + 1e-12 for x in known)
        assert is_there or number in OWN, (number, said(answer))


@pytest.mark.parametrize("verb", VERBS)
def test_version_seed_and_subject_are_those_of_the_record(verb: str) -> None:
    answer = ik.load(RESULTS / verb)
    record = answer.record
    assert record is not None
    text = said(answer)
    assert all(f"{name} {x}" in text for name, x in record.versions.items())
    other = replace(record, versions={"identknee": "9.8.7"}, seed=None, inputs={})
    bare = replace(answer, record=replace(other, settings={}), question=None, uncertainty={})
    assert re.findall(r"\d+\.\d+\.\d+", said(bare)) == ["9.8.7"]
    for word in ("seed", "SHA-256", "The knee was", "The data were", "noise of", "priors", "--"):
        assert word not in said(bare), word
    assert "version 9.8.7" in bare.methods()


@pytest.mark.parametrize("verb", ["fit", "profile", "sample", "diagnose", "sweep"])
def test_a_change_of_the_question_is_a_change_of_the_paragraph(verb: str) -> None:
    answer = ik.load(RESULTS / verb)
    sizes = {"weighting": "noise", "noise_mm": 0.21, "noise_deg": 0.43}
    stated = new(answer, changed(answer, sizes, noise="0.21mm,0.43deg"))
    assert NUMBER.findall(stated) == ["0.21", "0.43"]
    medians = new(answer, changed(answer, sizes, noise=None))
    assert NUMBER.findall(medians) == ["0.21", "0.43"]
    assert "medians" not in stated
    assert "medians" in medians
    assert "estimated" in new(answer, changed(answer, {"weighting": "estimated"}))
    assert "counted alike" in changed(answer, {"weighting": "unit"})
    assert "Priors" in new(answer, changed(answer, {"priors": True}))
    assert "no priors" in changed(answer, {"priors": False})
    acl, mcl = "ACL.stiffness_kN", "MCL.stiffness_kN"
    assert parameter_words(mcl) in new(answer, changed(answer, {"fixed": (mcl,)}))
    bounded = new(answer, changed(answer, {"bounds": {acl: (5.0, 15.0)}}))
    assert f"{parameter_words(acl)} (5 to 15)" in bounded
    left_out = new(answer, changed(answer, {"left_out_by_name": ("odd",)}))
    assert left_out.startswith("1 ")
    assert left_out.endswith(" choice: odd.")
    contradicted = new(answer, changed(answer, {"contradicted": ("odd",)}))
    assert contradicted.startswith("1 ")
    assert contradicted.endswith(": odd.")
    assert "contradicts" in contradicted
    assert "evidence: ACL.tension_N" in changed(answer, {"plausibility": ("ACL.tension_N",)})
    uncertain = said(replace(answer, uncertainty={"insertions_mm": "2 mm", "load_gain": "5 %"}))
    assert "insertions (2 mm)" in uncertain
    assert "load gain (5 %)" in uncertain
    assert "as exact" not in uncertain


def test_each_verb_says_how_it_went_about_it() -> None:
    fitted = ik.load(RESULTS / "fit")
    assert isinstance(fitted, ik.Calibration)
    search = replace(fitted.search, method="complex")
    words = changed(replace(fitted, search=search, start="IG3"), more_starts=7)
    search_words = new(fitted, words)
    assert search_words.index("complex") < search_words.index("IG3")
    assert "7" in NUMBER.findall(search_words)
    assert "Box (1965)" in words
    assert "Box (1965)" not in fitted.methods()
    assert "Student's t" in changed(fitted, likelihood="student")
    assert "Student's t" not in said(fitted)
    assert "t1 and t2" in new(fitted, changed(fitted, hold_out=["t1", "t2"]))
    profiles = ik.load(RESULTS / "profile")
    assert isinstance(profiles, ik.Profiles)
    own = next(iter(profiles.parameters.values()))
    assert f"{100 * own.level:g} % interval" in said(profiles)
    assert f"{own.threshold:.3g}" in said(profiles)
    assert "40" in NUMBER.findall(new(profiles, changed(profiles, bootstrap=40)))
    estimated = said(replace(profiles, degrees_of_freedom=33))
    assert "F law" in estimated
    assert "33" in NUMBER.findall(estimated)
    sampled = ik.load(RESULTS / "sample")
    assert isinstance(sampled, ik.Sample)
    assert sampled.sentence in said(sampled)
    assert "6" in NUMBER.findall(new(sampled, changed(sampled, n_ensembles=6)))
    swept = ik.load(RESULTS / "sweep")
    assert isinstance(swept, ik.Sweep)
    assert f"at {swept.searches.n} starts" in said(swept)
    shells = new(swept, changed(replace(swept, design="shells"), distances="0,1.25"))
    assert " 0,1.25 kN" in shells
    found = ik.load(RESULTS / "diagnose")
    assert isinstance(found, ik.Diagnosis)
    assert f"{len(found.effects)} possible causes" in said(found)
    assert found.noise is not None
    assert found.noise.sentence in said(found)


@pytest.mark.parametrize("verb", VERBS)
def test_the_call_has_every_option_that_is_not_as_usual(verb: str) -> None:
    answer = ik.load(RESULTS / verb)
    record = answer.record
    assert record is not None
    call = said(answer).partition("\n\nCall: ")[2]
    for flag in given_options(record):
        assert f" {flag} " in f" {call} " or f" --no-{flag[2:]} " in f" {call} ", flag
    assert record.verb in {x.name for x in verbs()}


def test_no_folder_of_this_machine_is_in_the_paragraph() -> None:
    text = changed(ik.load(RESULTS / "fit"), data="/home/me/left knee/data.csv", out="/tmp/x")
    assert "/home" not in text
    assert "/tmp" not in text
    (table,) = (x for x in text.split(". ") if "data.csv (SHA" in x)
    assert "2" in NUMBER.findall(table)


def test_what_no_verb_gave_back_has_no_methods() -> None:
    with pytest.raises(ValueError, match="no record"):
        straight_profiles().methods()
