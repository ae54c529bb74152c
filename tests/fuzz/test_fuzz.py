"""Mutated inputs to every reader and verb: each ends with success or with one sentence.

The same 200 every time; `.ci/nightly` tries 20,000 others every night.
"""

from pathlib import Path

import pytest
from fuzz_judge import judged
from fuzz_targets import TARGETS, Target, draw_page
from run_fuzz import endings
from slow_cases import some_slow

INPUTS = 200
KEPT = Path(__file__).parent / "kept"


LONG = [x for x in TARGETS if x.name == "long verbs"]


@pytest.mark.parametrize("target", some_slow(TARGETS, LONG), ids=[x.name for x in TARGETS])
def test_mutated_inputs_end_well(target: Target) -> None:
    n = -(-INPUTS * target.share // sum(x.share for x in TARGETS))
    found = [ending for _, ending in endings(target, n, 0)]
    assert len(found) == n
    assert [x.what for x in found if x.kind == "failed"] == []


@pytest.mark.parametrize(
    "place", sorted(KEPT.glob("*/*")), ids=lambda x: f"{x.parent.name} {x.name}"
)
def test_what_once_ended_badly_ends_well(place: Path, tmp_path: Path) -> None:
    (target,) = (x for x in TARGETS if x.name == place.parent.name)
    ending = judged(lambda: target.run(place.read_bytes(), tmp_path))
    assert ending.kind != "failed", ending.what


def test_a_whole_result_makes_a_page(tmp_path: Path) -> None:
    """The golden texts have the pages of all."""
    content = b"simulate\n" + (KEPT.parent / "results" / "simulate" / "result.json").read_bytes()
    ending = judged(lambda: draw_page(content, tmp_path))
    assert (ending.kind, ending.what) == ("done", "")


def test_the_judge_sees_what_must_not_be(tmp_path: Path) -> None:
    def warn() -> str:
        import warnings

        warnings.warn("divided by zero", RuntimeWarning, stacklevel=1)
        return ""

    def speak() -> str:
        import sys

        print("trouble", file=sys.stderr)
        return ""

    def crash() -> str:
        return str([][0])

    def blame_the_library() -> str:
        return str(float("x"))

    for action in (warn, speak, crash, blame_the_library, lambda: "two\nlines"):
        assert judged(action).kind == "failed"
    assert judged(lambda: "").kind == "done"
    assert judged(lambda: "one sentence").kind == "refused"
