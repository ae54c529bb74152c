"""Grading of answers: what is right, what is wrong, and what is wrong without a word."""

import dataclasses
import math
import re

import numpy as np
import pytest
from conformance.case import Answer, Case
from conformance.score import (
    ConformanceReport,
    Grade,
    conformance_cases,
    run_conformance,
)

CASES = {case.name: case for case in conformance_cases()}
CLOSED, OPEN = CASES["quadratic"], CASES["open above"]


def _exact(case: Case) -> Answer:
    return Answer(intervals=case.intervals, verdict=min(case.verdict), n_simulations=7)


def _grade(case: Case, answer: Answer) -> Grade:
    return run_conformance(lambda _: answer, [case]).graded[0].grade


def test_exact_answers_are_right() -> None:
    report = run_conformance(_exact)
    assert report.count(Grade.RIGHT) == len(CASES)
    assert report.n_simulations == 7 * len(CASES)
    assert all(one.why == "" for one in report.graded)


@pytest.mark.parametrize(("error", "grade"), [(0.9e-3, Grade.RIGHT), (1.1e-3, Grade.SILENT)])
def test_an_end_may_be_off_by_a_thousandth_of_the_half_width(error: float, grade: Grade) -> None:
    low, high = CLOSED.intervals[0]
    moved = low + error * 0.5 * (high - low)
    assert _grade(CLOSED, Answer(intervals=((moved, high),))) is grade


def test_another_accuracy_may_be_asked() -> None:
    low, high = CLOSED.intervals[0]
    answer = Answer(intervals=((low + 0.02 * (high - low), high),))
    kind = run_conformance(lambda _: answer, [CLOSED], accuracy=0.05)
    assert kind.count(Grade.RIGHT) == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e6])
def test_a_closed_end_given_otherwise_is_wrong(bad: float) -> None:
    low, _ = CLOSED.intervals[0]
    assert _grade(CLOSED, Answer(intervals=((low, bad),))) is Grade.SILENT


def test_an_open_end_given_as_a_number_is_wrong() -> None:
    low, _ = OPEN.intervals[0]
    assert _grade(OPEN, Answer(intervals=((low, 2.0),))) is Grade.SILENT


def test_wrong_words_are_wrong_and_no_words_are_not() -> None:
    answer = _exact(OPEN)
    assert _grade(OPEN, answer) is Grade.RIGHT
    for other in (
        dataclasses.replace(answer, upper="open_flat"),
        dataclasses.replace(answer, verdict="identifiable"),
        dataclasses.replace(answer, lower="failed"),
    ):
        assert _grade(OPEN, other) is not Grade.RIGHT


@pytest.mark.parametrize(
    "answer",
    [
        Answer(intervals=(), warnings=("no convergence",)),
        Answer(intervals=(), lower="failed"),
        Answer(intervals=(), upper="open_budget"),
    ],
)
def test_a_wrong_answer_with_a_doubt_is_not_silent(answer: Answer) -> None:
    assert _grade(CLOSED, answer) is Grade.FLAGGED


def test_a_tool_that_breaks_down_has_said_so() -> None:
    def broken(_: Case) -> Answer:
        raise ZeroDivisionError("by zero")

    def limited(_: Case) -> Answer:
        raise NotImplementedError("no profiles of functions")

    report = run_conformance(broken, [CLOSED])
    assert report.graded[0].grade is Grade.FLAGGED
    assert report.graded[0].why.startswith("ZeroDivisionError: ")
    report = run_conformance(limited, [CLOSED])
    assert report.graded[0].grade is Grade.UNSUPPORTED


def test_the_table_says_what_is_wrong() -> None:
    report = run_conformance(lambda _: Answer(intervals=((0.0, 1.0),)), [CLOSED, OPEN])
    assert isinstance(report, ConformanceReport)
    text = str(report)
    assert re.search(r"0 to 1 .*0\.412011 to 1\.58799", text)
    assert re.search(r"2 cases: 0 .*, 0 .*, 2 wrong", text)


def test_a_case_knows_its_threshold_and_its_optimum_cannot_be_changed() -> None:
    assert CLOSED.threshold == pytest.approx(1.959963984540054**2, rel=1e-12)
    assert CASES["quadratic at one sd"].threshold == pytest.approx(1.0, rel=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        CLOSED.optimum[0] = 0.0


@pytest.mark.parametrize("name", CASES)
def test_derivatives_of_the_cases(name: str) -> None:
    """Against central differences, at a place without a kink, a jump or noise."""
    problem = CASES[name].problem
    if name == "noisy residuals":
        pytest.skip("its derivatives are to miss the noise")
    theta = np.clip(CASES[name].optimum + 0.0137, problem.parameters.lower, None)
    theta = np.where(theta > problem.parameters.upper, CASES[name].optimum - 0.0137, theta)
    step = 1e-6 * np.maximum(1.0, np.abs(theta))
    columns = []
    for i in range(theta.size):
        move = np.zeros(theta.size)
        move[i] = step[i]
        difference = problem.residuals(theta + move) - problem.residuals(theta - move)
        columns.append(difference / (2 * step[i]))
    jacobian = problem.jacobian(theta)
    scale = np.abs(jacobian).max(initial=1.0)
    # Rounding of residuals of this size in a step of 1e-6.
    rounding = 1e-9 * np.abs(problem.residuals(theta)).max()
    np.testing.assert_allclose(
        np.stack(columns, axis=1), jacobian, atol=1e-7 * scale + rounding, rtol=1e-6
    )
