"""The head of the report: what methods say together, and whether fits agree."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnoses import FRAME, answered
from golden_texts import Golden
from report_folders import few_trials, profile_folder, straight_profiles

from identknee.identify.profile.result import ProfileVerdict
from identknee.report.overview import (
    Relation,
    Tone,
    agreement,
    disagreement,
    fits_by_start,
    has_better_fit,
    overview,
    ranges_of,
    reasons,
    relation,
    searches_sentences,
)
from identknee.report.presenter import Range, Source
from identknee.report.results import by_subject, found_results
from identknee.runs.declare import Array
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import untestable
from identknee.verbs.files import load
from identknee.verbs.fit import Calibration, fit
from identknee.verbs.profile import Profiles
from identknee.verbs.simulate import simulate


def a_range(
    low: float | None,
    high: float | None,
    source: Source = Source.POSTERIOR,
    reach: float | None = 1.0,
) -> Range:
    return Range(source=source, low=low, high=high, value=10.0, status="known", reach=reach)


MAIN = a_range(8.0, 12.0, Source.PROFILE)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ((8.5, 11.5), Relation.SAME),
        ((9.5, 10.5), Relation.NARROWER),
        ((5.0, 12.5), Relation.WIDER),
        ((6.0, 10.0), Relation.LOWER),
        ((10.0, 14.0), Relation.HIGHER),
        ((13.0, 14.0), Relation.APART),
        ((8.0, None), Relation.OPEN),
    ],
)
def test_how_one_range_lies_to_another(
    other: tuple[float | None, float | None], expected: Relation
) -> None:
    assert relation(MAIN, a_range(*other)) is expected


def test_an_open_end_agrees_with_an_open_end_only() -> None:
    main = a_range(8.0, None, Source.PROFILE)
    assert relation(main, a_range(7.0, None)) is Relation.SAME
    assert relation(main, a_range(7.0, 20.0)) is Relation.CLOSED


def test_ends_that_are_open_on_other_sides_do_not_close_a_set() -> None:
    main = a_range(8.0, None, Source.PROFILE)
    assert relation(main, a_range(None, 9.0)) is Relation.OPEN
    assert relation(main, a_range(None, 7.0)) is Relation.APART


def test_a_set_as_wide_is_not_called_narrower_or_wider() -> None:
    main = a_range(0.0, 10.0, Source.PROFILE)
    assert relation(main, a_range(-1.4, 8.4)) is Relation.LOWER
    assert relation(main, a_range(1.4, 11.8)) is Relation.HIGHER
    assert relation(main, a_range(-1.0, 4.0)) is Relation.NARROWER


def test_equivalent_sets_are_scaled_to_the_limit_of_the_profile() -> None:
    # A quarter of the squared misfit is half the width.
    narrow = a_range(9.0, 11.0, Source.EQUIVALENTS, reach=0.25)
    assert relation(MAIN, narrow) is Relation.SAME
    assert relation(MAIN, replace(narrow, reach=1.0)) is Relation.NARROWER
    found = agreement([MAIN, narrow])
    assert found.sentence("kN") == "both agree"
    assert "0.25 times" in reasons([found])


def test_methods_that_differ_are_named_with_their_range_and_reason(golden: Golden) -> None:
    found = agreement([MAIN, a_range(9.9, 10.1), a_range(8.0, 12.0, Source.DIAGNOSIS)])
    golden("said/methods-that-differ", f"{found.sentence('kN')}\n{reasons([found])}")


def test_what_has_not_converged_is_said_so(golden: Golden) -> None:
    answer = load(Path(__file__).parents[2] / "fuzz" / "results" / "sample")
    assert overview([answer]).tone is Tone.OPEN
    golden("said/not-converged", overview([answer]).verdict)


def with_profiles(verdicts: Mapping[str, tuple[float | None, float | None]]) -> Profiles:
    """Profiles of these ends."""
    whole = straight_profiles()
    (one, *_) = whole.parameters.values()
    made = {}
    for name, (low, high) in verdicts.items():
        sides = [
            replace(one.upper_side, end=x, status=type(one.upper_side.status)("closed"))
            for x in (low, high)
        ]
        made[name] = replace(
            one,
            name=name,
            intervals=((low, high),),
            lower_side=sides[0],
            upper_side=sides[1],
            verdict=ProfileVerdict.IDENTIFIABLE
            if low is not None and high is not None
            else ProfileVerdict.ONE_SIDED,
        )
    return replace(whole, parameters=made)


def test_the_verdict_counts_what_is_known_and_names_what_is_open(golden: Golden) -> None:
    known = with_profiles({"ACL.stiffness_kN": (8.0, 12.0), "PCL.stiffness_kN": (15.0, 22.0)})
    both = overview([known])
    assert both.tone is Tone.GOOD
    cut = with_profiles({"ACL.stiffness_kN": (8.0, 12.0), "PCL.stiffness_kN": (15.0, None)})
    said = overview([cut])
    golden("said/known-and-open", f"{both.verdict}\n{said.verdict}")
    assert said.tone is Tone.OPEN
    assert [x.limits for x in said.rows] == ["8 to 12 kN", "15 kN upwards"]


def test_a_cause_found_is_in_the_verdict_and_alarms() -> None:
    said = overview([answered(FRAME)])
    assert said.tone is Tone.WRONG
    assert said.rows
    assert overview([untestable("Why.")]).tone is Tone.OPEN


def test_methods_that_contradict_each_other_are_in_the_verdict() -> None:
    diagnosis = answered(FRAME)
    (name, found), *_ = ranges_of([diagnosis]).items()
    (main, *_) = found
    assert main.high is not None
    far = with_profiles({name: (main.high + 10.0, main.high + 11.0)})
    said = overview([far, diagnosis])
    assert "one another" in said.verdict
    assert "the cause" in said.verdict
    assert "contradicts" in said.rows[0].agreement


@pytest.fixture(scope="module")
def fitted(reference: Knee) -> Calibration:
    laxity = simulate(reference, few_trials(), noise="0.3mm,0.3deg", seed=1).noisy
    assert laxity is not None
    return fit(reference, laxity, budget=3)


def moved(fitted: Calibration, shift: Array, start: str) -> Calibration:
    search = replace(fitted.search, theta=fitted.search.theta + shift)
    return replace(fitted, search=search, start=start)


def test_fits_that_end_elsewhere_are_said_to_disagree(fitted: Calibration) -> None:
    shift = np.zeros(len(fitted.parameter_names))
    near, far = shift.copy(), shift.copy()
    near[0], far[1] = 0.1, -3.0
    one = replace(fitted, start="IG1")
    agreeing = [one, moved(fitted, near, "IG2")]
    assert disagreement(fits_by_start(agreeing)) == ""
    told = " ".join(searches_sentences(agreeing))
    # Alike in all that is said of them: one clause for both.
    assert re.match("The 2 fits .*IG1.*IG2", told)
    assert told.count("IG2") == 1
    apart = moved(fitted, far, "IG2")
    said = disagreement(fits_by_start([one, apart]))
    value = float(fitted.search.theta[1])
    assert re.search(f"{value:.3g} kN .*IG1.* {value - 3.0:.3g} kN .*IG2", said)
    disagreeing, agreed = (overview(x).verdict for x in ([one, apart], agreeing))
    assert disagreeing != agreed


def test_a_fit_is_beaten_by_one_of_the_same_data_that_leaves_less(fitted: Calibration) -> None:
    def left(mm: float, deg: float, n_compared: int = 10) -> Calibration:
        rmse = replace(fitted.rmse, mm=mm, deg=deg, n_compared=n_compared)
        return replace(fitted, rmse=rmse)

    one = left(0.5, 0.8)
    assert has_better_fit(one, [left(0.5, 0.8), left(0.4, 0.7)])
    assert not has_better_fit(one, [one, left(0.4, 0.9), left(0.49999, 0.79999)])
    # Angles alone were measured.
    assert has_better_fit(left(np.nan, 0.8), [left(np.nan, 0.7)])
    # It rests on fewer trials, or on none.
    assert not has_better_fit(one, [left(0.4, 0.7, n_compared=3)])
    assert not has_better_fit(left(np.nan, np.nan, n_compared=0), [one])
    others = replace(fitted.data, coordinates=fitted.data.coordinates + 0.1)
    assert not has_better_fit(one, [replace(left(0.4, 0.7), data=others)])


def test_many_fits_are_one_paragraph(fitted: Calibration) -> None:
    many = [replace(fitted, start=f"start{i}") for i in range(20)]
    assert len(" ".join(searches_sentences(many))) < 400


def test_profiles_of_one_table_are_told_once_and_other_tables_apart(tmp_path: Path) -> None:
    for name in "ab":
        profile_folder(tmp_path / name)
    (findings,) = by_subject(found_results(tmp_path))
    assert len(findings.merged.results) == 1
    assert len(findings.of_main_data) == 2


def test_a_demonstration_is_answered_first(golden: Golden) -> None:
    demo = load(Path(__file__).parents[2] / "fuzz" / "results" / "demo")
    found = overview([demo])
    golden("said/demonstration", found.verdict)
    assert not found.searches
