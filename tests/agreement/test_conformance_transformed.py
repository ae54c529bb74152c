"""identknee's own profiles on the conformance suite in other units, shifted and mirrored."""

import pytest
from conformance.score import Grade, run_conformance
from conformance.tool import identknee_tool
from slow_cases import some_slow
from transformed_cases import SHIFTABLE, transformed

QUICK = set(list(SHIFTABLE)[1::4]) - {"fewer data than parameters"}


@pytest.mark.parametrize("name", some_slow(SHIFTABLE, set(SHIFTABLE) - QUICK))
def test_the_answer_is_right(name: str) -> None:
    report = run_conformance(identknee_tool, [transformed(SHIFTABLE[name], seed=2)])
    assert report.graded[0].grade is Grade.RIGHT, str(report)
