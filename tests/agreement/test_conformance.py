"""identknee's own profiles on the conformance suite: all right."""

import pytest
from conformance.score import Grade, conformance_cases, run_conformance
from conformance.tool import identknee_tool
from slow_cases import some_slow

CASES = {case.name: case for case in conformance_cases()}


@pytest.mark.parametrize("name", some_slow(CASES, ["fewer data than parameters, one known"]))
def test_the_answer_is_right(name: str) -> None:
    report = run_conformance(identknee_tool, [CASES[name]])
    assert report.graded[0].grade is Grade.RIGHT, str(report)
