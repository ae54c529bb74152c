"""Scores of diagnoses made by hand, and the sealed truth."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identknee.blind.scoring import score
from identknee.blind.truth import Truth, read_truth, write_truth
from identknee.runs.errors import InputError
from identknee.runs.schema import summary_of

TRUTH = Truth(
    seed=7,
    effects=("anterolateral",),
    amplitudes={"anterolateral": {"amplitude": (0.5, "kN"), "stiffness_kN": (0.5, "kN")}},
    theta={"ACL.stiffness_kN": 10.0, "ACL.reference_strain_pct": 8.0},
    signal=12.0,
    is_largest=False,
    lines={"anterolateral": (np.array([0.0, 0.0, 40.0]), np.array([0.0, -40.0, 40.0]))},
    facts={"redraws": 0},
)
NULL = replace(TRUTH, effects=(), amplitudes={}, lines={}, signal=0.0)
UNLISTED = replace(TRUTH, effects=("missing_line",))
PAIR = replace(TRUTH, effects=("anterolateral", "drift"))
MOUNTED, REMOUNTED = (replace(x, facts={"largest_remounting": 0.5}) for x in (TRUTH, NULL))


def _diagnosis(verdict: str, *causes: str, group: tuple[str, ...] = ()) -> dict[str, Any]:
    return {"verdict": verdict, "causes": [{"name": x} for x in causes], "group": list(group)}


@pytest.mark.parametrize(
    ("truth", "diagnosis", "correct", "wrong"),
    [
        (TRUTH, _diagnosis("NAMED", "anterolateral"), True, False),
        (TRUTH, _diagnosis("NAMED", "meniscus"), False, True),
        (TRUTH, _diagnosis("NAMED", "anterolateral", "meniscus"), False, True),
        (TRUTH, _diagnosis("AMBIGUOUS", group=("anterolateral", "meniscus")), True, False),
        (TRUTH, _diagnosis("AMBIGUOUS", group=("drift", "meniscus")), False, False),
        (TRUTH, _diagnosis("ADEQUATE"), False, False),
        (TRUTH, _diagnosis("UNEXPLAINED"), False, False),
        (TRUTH, _diagnosis("NOT_TESTABLE"), False, False),
        (NULL, _diagnosis("ADEQUATE"), True, False),
        (NULL, _diagnosis("NAMED", "meniscus"), False, True),
        (NULL, _diagnosis("AMBIGUOUS", group=("meniscus", "drift")), False, False),
        (UNLISTED, _diagnosis("UNEXPLAINED"), True, False),
        (UNLISTED, _diagnosis("NAMED", "meniscus"), False, True),
        (PAIR, _diagnosis("NAMED", "anterolateral", "drift"), True, False),
        (PAIR, _diagnosis("NAMED", "drift"), False, False),
        (NULL, _diagnosis("NAMED", "remounting"), False, True),
        (REMOUNTED, _diagnosis("NAMED", "remounting"), True, False),
        (REMOUNTED, _diagnosis("NAMED", "meniscus"), False, True),
        (REMOUNTED, _diagnosis("AMBIGUOUS", group=("remounting", "drift")), True, False),
        (MOUNTED, _diagnosis("NAMED", "remounting"), False, False),
        (MOUNTED, _diagnosis("NAMED", "remounting", "anterolateral"), True, False),
    ],
)
def test_right_and_wrong(
    truth: Truth, diagnosis: dict[str, Any], correct: bool, wrong: bool
) -> None:
    found = score(truth, diagnosis)
    assert (found.correct, found.wrong) == (correct, wrong)
    assert diagnosis["verdict"] in found.sentence


def test_a_line_is_compared_with_the_true_one() -> None:
    line = {"femur": [5.0, 10.0, 40.0], "tibia": [5.0, -10.0, 40.0]}
    found = score(TRUTH, {**_diagnosis("UNEXPLAINED"), "line": line})
    assert found.line_offset_mm == pytest.approx(5.0)
    assert found.line_angle_deg == pytest.approx(0.0)
    tilted = {"femur": [0.0, 0.0, 40.0], "tibia": [40.0, -40.0, 40.0]}
    found = score(TRUTH, {**_diagnosis("UNEXPLAINED"), "line": tilted})
    assert found.line_angle_deg == pytest.approx(45.0)


def test_parameters_and_intervals_are_compared_before_and_after() -> None:
    before = {"ACL": {"stiffness_kN": 4.0, "reference_strain_pct": 9.0}}
    after = {"ACL": {"stiffness_kN": 9.5, "reference_strain_pct": 8.5}}
    intervals = {"ACL": {"stiffness_kN": [9.0, 10.5], "reference_strain_pct": [8.2, None]}}
    stiffness = {"value": 0.4, "unit": "kN", "ci95": [0.3, 0.6]}
    cause = {"name": "anterolateral", "parameters": {"stiffness_kN": stiffness}}
    found = score(
        TRUTH,
        {
            "verdict": "NAMED",
            "causes": [cause],
            "parameters_before": before,
            "parameters_after": after,
            "parameters_after_ci95": intervals,
        },
    )
    assert found.stiffness_error_kN == pytest.approx((6.0, 0.5))
    assert found.strain_error_pct == pytest.approx((1.0, 0.5))
    assert found.covered_before is None
    assert found.covered_after == 0.5
    assert found.amplitudes_covered == 1.0


def test_a_diagnosis_needs_a_verdict() -> None:
    with pytest.raises(ValueError, match="no verdict"):
        score(TRUTH, {})


def test_the_truth_comes_back_and_cannot_be_read_by_accident(tmp_path: Path) -> None:
    path = write_truth(TRUTH, tmp_path)
    assert "anterolateral" not in path.read_text(encoding="utf-8")
    assert summary_of(read_truth(tmp_path)) == summary_of(TRUTH)


def test_a_file_that_is_no_truth_is_refused(tmp_path: Path) -> None:
    (tmp_path / "truth.json").write_text('{"sealed": "x"}', encoding="utf-8")
    with pytest.raises(InputError, match="no sealed truth"):
        read_truth(tmp_path)


@pytest.mark.parametrize(
    ("offset_mm", "angle_deg", "is_near"),
    [(9.0, 0.0, True), (11.0, 0.0, False), (0.0, 14.0, True), (0.0, 16.0, False)],
)
def test_a_line_is_the_true_one_within_10_mm_and_15_deg(
    offset_mm: float, angle_deg: float, is_near: bool
) -> None:
    """Ends of two structures of one side lie farther apart; 60 mm is the other side of the knee."""
    truth = replace(UNLISTED, lines={"missing_line": TRUTH.lines["anterolateral"]})
    middle = np.array([offset_mm, -20.0, 40.0])
    way = np.array([np.sin(np.radians(angle_deg)), -np.cos(np.radians(angle_deg)), 0.0])
    line = {"femur": middle - 20.0 * way, "tibia": middle + 20.0 * way}
    found = score(truth, {**_diagnosis("NAMED", "deep_mcl"), "line": line})
    assert found.correct is is_near
    assert found.wrong is not is_near


def test_two_names_are_wrong_even_where_one_line_is_right() -> None:
    truth = replace(UNLISTED, lines={"missing_line": TRUTH.lines["anterolateral"]})
    femur, tibia = TRUTH.lines["anterolateral"]
    found = score(
        truth,
        {**_diagnosis("NAMED", "deep_mcl", "drift"), "line": {"femur": femur, "tibia": tibia}},
    )
    assert found.wrong
