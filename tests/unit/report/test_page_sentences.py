"""What the page says of results, in words."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from golden_texts import Golden
from report_folders import straight_profiles, write_given

from identknee.diagnosis.candidates import Detectability
from identknee.identify.profile.result import (
    EndOrigin,
    Interval,
    Profile,
    ProfileVerdict,
    Side,
    SideStatus,
)
from identknee.report.answers.profile import parameter_statements, profile_range
from identknee.report.overview import KNOWN
from identknee.report.page.page import report_html, warnings
from identknee.report.presenter import Question, statements_of
from identknee.report.results import found_results
from identknee.runs.findings import finding
from identknee.subject.reference import reference_knee
from identknee.verbs.fit import fit
from identknee.verbs.isolability import ConfusableCauses, Isolability
from identknee.verbs.simulate import simulate
from identknee.verbs.values import AdvisedTrial


def profile(
    name: str,
    ends: Interval,
    verdict: ProfileVerdict,
    *,
    intervals: tuple[Interval, ...] = (),
    upper: tuple[SideStatus, float] = (SideStatus.OPEN_FLAT, 99.0),
) -> Profile:
    """A profile of which only the words matter."""
    low, high = (
        Side(
            status=upper[0] if end is None else SideStatus.CLOSED,
            end=end,
            error=0.0,
            reached=upper[1],
            max_deviance=1.0,
            at_bounds=(),
        )
        for end in ends
    )
    return Profile(
        name=name,
        unit="kN",
        optimum_value=10.0,
        intervals=intervals or (ends,),
        lower_side=low,
        upper_side=high,
        verdict=verdict,
        level=0.95,
        threshold=3.84,
        practical_level=0.95,
        deviance=1.0,
        n_simulations=5,
        n_restarts=0,
        optimum=np.array([10.0]),
        values=np.array([10.0]),
        thetas=np.array([[10.0]]),
        deltas=np.array([0.0]),
        slopes=np.array([0.0]),
        branches=np.array([0]),
    )


def on_bound(of: str) -> Profile:
    """Known on both sides but for another parameter's bound above."""
    made = profile("ACL.stiffness_kN", (8.8, 25.8), ProfileVerdict.BOUNDED_BY_ASSUMPTION)
    low = replace(made.lower_side, made_by=EndOrigin.DATA)
    high = replace(made.upper_side, made_by=EndOrigin.BOUND, bound_of=of)
    return replace(made, lower_side=low, upper_side=high)


def said_of(*profiles: Profile) -> list[str]:
    return [x.sentence for x in parameter_statements(profiles)]


def test_an_end_on_the_bound_of_another_is_said_to_be(golden: Golden) -> None:
    found = on_bound("PCL.stiffness_kN")
    (statement,) = parameter_statements([found])
    (table,) = statement.tables
    golden("said/end-on-a-bound", f"{statement.sentence}\n{found.sentence}\n{table}")
    assert profile_range(found).status not in KNOWN
    # Where data make all ends the table has no such column.
    (known,) = parameter_statements([replace(found, upper_side=found.lower_side)])
    assert len(known.tables[0].columns) == len(table.columns) - 1


def test_known_and_unknown_stand_in_one_sentence(golden: Golden) -> None:
    (said,) = said_of(
        profile("ACL.stiffness_kN", (8.8, 11.2), ProfileVerdict.IDENTIFIABLE),
        profile("band.stiffness_kN", (6.0, None), ProfileVerdict.ONE_SIDED),
        profile("LCL.stiffness_kN", (None, None), ProfileVerdict.PRACTICALLY_NONIDENTIFIABLE),
    )
    golden("said/known-and-unknown", said)


def test_an_end_that_only_the_model_makes_is_said_to_be_open(golden: Golden) -> None:
    cut = profile(
        "PCL.stiffness_kN",
        (14.9, None),
        ProfileVerdict.ONE_SIDED,
        upper=(SideStatus.OPEN_AT_FEASIBILITY, 25.438),
    )
    (statement,) = parameter_statements([cut])
    golden("said/open-end-of-the-model", statement.sentence)
    (table,) = statement.tables
    assert str(table.rows[0][3]).endswith(" 25.44")


def test_of_many_the_best_and_all_open_ones_are_named() -> None:
    ends: dict[int, Interval] = {i: (9.0 - i, 11.0) for i in range(5)}
    ends |= {5: (None, 11.0), 6: (9.0, None)}
    (said,) = said_of(
        *(profile(f"line{i}.stiffness_kN", x, ProfileVerdict.ONE_SIDED) for i, x in ends.items())
    )
    named = [f"line{i}" for i in range(7) if f"line{i}" in said]
    assert named == ["line0", "line5", "line6"]


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        (ProfileVerdict.UNDETERMINED, "is undecided"),
        (
            ProfileVerdict.MULTIMODAL,
            "lies in one of several separate ranges (1 to 2 kN or 3 to 4 kN)",
        ),
        (ProfileVerdict.STRUCTURALLY_SUSPECT, "more data of this kind may not help"),
    ],
)
def test_every_verdict_has_its_words(verdict: ProfileVerdict, words: str) -> None:
    several = verdict is ProfileVerdict.MULTIMODAL
    ends: Interval = (1.0, 4.0) if several else (None, None)
    parts: tuple[Interval, ...] = ((1.0, 2.0), (3.0, 4.0)) if several else ()
    (said,) = said_of(profile("ACL.stiffness_kN", ends, verdict, intervals=parts))
    assert words in said.replace("from ", "")


def test_what_was_taken_for_granted_is_on_the_page(tmp_path: Path) -> None:
    answer = replace(straight_profiles(), assumptions=("Assumed.",))
    (found,) = found_results(write_given(tmp_path, "profile", answer))
    assert "Assumed." in report_html([found])


def test_stored_findings_stand_where_they_belong_and_lead(tmp_path: Path) -> None:
    findings = (
        finding("moves-against-load", "data", sentence="Wrong sign."),
        finding("at-bound", "parameters", sentence="At bounds."),
        finding("lowest-found-once", "starts", sentence="Tried again."),
    )
    answer = replace(straight_profiles(), findings=findings)
    (found,) = found_results(write_given(tmp_path, "profile", answer))
    said = [(x.question, x.sentence, x.warning is not None) for x in warnings(found)]
    assert said == [
        (Question.WRONG, "Error: Wrong sign.", True),
        (Question.WRONG, "Warning: At bounds.", True),
        (Question.SEARCH, "Warning: Tried again.", True),
    ]
    page = report_html([found])
    assert page.index("Wrong sign.") < page.index("Tried again.")


def test_a_start_that_failed_is_not_called_a_fit() -> None:
    slack = {f"{x}.stiffness_kN": 0.0 for x in ("ACL", "PCL", "LCL", "MCL")}
    knee = reference_knee()
    laxity = simulate(knee, "drawer").laxity
    lax = replace(knee, ligaments=tuple(replace(x, stiffness_kN=0.0) for x in knee.ligaments))
    answer = fit(lax, laxity, fixed=list(slack))
    assert slack.keys() <= set(answer.parameter_names)
    (said,) = statements_of(answer)
    assert "no prediction" in said.sentence


def test_a_plan_says_what_it_could_not_tell_apart(golden: Golden) -> None:
    trial = AdvisedTrial(trial="a", flexion_deg=90.0, anterior_force_N=-134.0)
    seen = {
        name: Detectability(
            name=name, parameter="k", unit="kN", detectable=np.inf, relevant=0.2, power=0.05
        )
        for name in "ab"
    }
    group = ConfusableCauses(
        effects=("a", "b"), distance=2.0, distance_with_advised_trials=7.0, advised_trials=(trial,)
    )
    answer = Isolability(
        protocol="seed63",
        n_trials=63,
        groups=(group,),
        look_alikes={"a": ("b",), "b": ("a",)},
        effects=seen,
        rivals=("a", "b"),
        distances=np.full((2, 2), 2.0),
        root_noncentrality=8.0,
        least_distance=5.0,
    )
    plan, advice = statements_of(answer)
    golden("said/plan", f"{plan.sentence}\n{advice.sentence}")
    assert plan.tables[0].texts()[0] == ["a", "not detectable", "0.2 kN", "b"]
