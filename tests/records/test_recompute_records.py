"""The records' heads, and the tool that computes a share of them again."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from recompute_records import ABSOLUTE, STUDIES, Entry, differences, draw, head_problems, load
from recompute_records import studies as studies_that_take_part
from slow_cases import some_slow

RECORDS = sorted(STUDIES.glob("*/records/*.json"))
# With the largest records; those that are no older than the code are read by the gate's draw too.
SLOW = ("03_basin_of_attraction", "04_profiles", "09_optimizers", "11_reality_gap")


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _told(recorded: Any, found: Any) -> list[tuple[str, str, str]]:
    """Where the two differ: the name there, what was recorded and what was found."""
    lines = [re.fullmatch(r"(\S+) was (\S+), is (\S+)", x) for x in differences(recorded, found)]
    return [(x[1], x[2], x[3]) for x in lines if x is not None]


def _entry(name: str, *numbers: float, seconds: float = 0.0) -> Entry:
    recorded = {"numbers": list(numbers), "seconds": seconds}
    return Entry(name=name, recorded=recorded, recompute=lambda: recorded)


@pytest.mark.parametrize("path", RECORDS, ids=lambda x: x.stem)
def test_every_record_says_how_it_was_made_and_its_inputs_are_as_they_were(path: Path) -> None:
    assert head_problems(_read(path)) == []


@pytest.mark.parametrize("study", some_slow(studies_that_take_part(), SLOW))
def test_every_entry_has_its_own_name_and_numbers_of_the_record(study: str) -> None:
    (path,) = (STUDIES / study / "records").glob("*.json")
    found = [Entry(name=x, recorded=y, recompute=z) for x, y, z in load(study)(_read(path))]
    assert found
    assert len({x.name for x in found}) == len(found)
    assert sum(x.n_numbers for x in found) > 0


def test_a_changed_number_is_named_with_both_values() -> None:
    recorded = {"a": [1.0, 2.0], "name": "x", "seconds": 1.0}
    found = {"a": [1.0, 2.001], "name": "y", "seconds": 9.0}
    assert differences(recorded, recorded) == []
    assert _told(recorded, found) == [("a[1]", "2.0", "2.001"), ("name", "x", "y")]
    assert _told({"a": 1.0}, {"b": 1.0}) == [("a", "1.0", "absent"), ("b", "absent", "1.0")]


def test_the_last_digit_and_what_is_not_a_number_are_compared_as_a_record_keeps_them() -> None:
    assert differences({"a": 1.23457}, {"a": 1.23456}) == []
    assert differences({"a": 0.0}, {"a": ABSOLUTE / 2.0}) == []
    assert differences({"a": None}, {"a": float("nan")}) == []
    assert _told({"a": None}, {"a": 1.0}) == [("a", "None", "1.0")]
    assert _told({"a": True}, {"a": False}) == [("a", "True", "False")]


def test_a_search_may_take_a_little_longer_if_it_ends_there() -> None:
    """By a twentieth, or by two simulations where there are few."""
    recorded = {"fits": [{"n_simulations": 307, "end": 1.0}], "n_simulations": [10, 400]}
    near = {"fits": [{"n_simulations": 308, "end": 1.0}], "n_simulations": [12, 385]}
    far = {"fits": [{"n_simulations": 330, "end": 1.001}], "n_simulations": [13, 400]}
    assert differences(recorded, near) == []
    assert _told(recorded, far) == [
        ("fits[0].n_simulations", "307", "330"),
        ("fits[0].end", "1.0", "1.001"),
        ("n_simulations[0]", "10", "13"),
    ]
    assert _told({"n_trials": 63}, {"n_trials": 62}) == [("n_trials", "63", "62")]


def test_a_score_is_the_same_to_a_thousandth() -> None:
    recorded = {"scores": [{"score": 0.783838}, {"score": 0.0}]}
    assert differences(recorded, {"scores": [{"score": 0.783923}, {"score": 1e-7}]}) == []
    assert _told(recorded, {"scores": [{"score": 0.785}, {"score": 0.0}]}) == [
        ("scores[0].score", "0.783838", "0.785")
    ]


def test_entries_are_drawn_by_seed_until_there_are_enough() -> None:
    pool = [_entry(str(i), 1.0, 2.0, 3.0) for i in range(50)]
    names = [[x.name for x in draw(pool, 7, seed)] for seed in (1, 1, 2)]
    assert names[0] == names[1] != names[2]
    assert len(names[0]) == len(set(names[0])) == 3
    assert list(draw(pool[:2], 1000, 1)) != []


def test_what_takes_too_long_is_left_out() -> None:
    pool = [_entry("slow", 1.0, seconds=1000.0), _entry("quick", 1.0), _entry("empty")]
    assert [x.name for x in draw(pool, 10, 1)] == ["quick"]
