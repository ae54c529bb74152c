"""The row of varied axes: the same cases on each, counted and recorded part by part."""

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from blind_axes import AXES, PRIOR, TWICE
from blind_diagnoses import BlindTask

from identknee.blind.effects import LISTED


@pytest.fixture
def row(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module of the row, its diagnoses and its store replaced."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "verification"))
    import verify_blind_axes

    @contextmanager
    def nowhere(*_: object) -> Iterator[None]:
        yield

    def answered(_: object, tasks: Sequence[BlindTask], **__: object) -> list[dict[str, Any]]:
        return [outcome(x) for x in tasks]

    monkeypatch.setattr(verify_blind_axes, "work_store", nowhere)
    monkeypatch.setattr(verify_blind_axes, "resumable_map", answered)
    return verify_blind_axes


def outcome(task: BlindTask) -> dict[str, Any]:
    """Compression is called a frame on one axis, every tenth null alarms, two have no case."""
    if "meniscus" in task.effects and task.signal in (4.0, 6.0):
        return {"error": "no draw", "effects": list(task.effects), "signal": task.signal}
    wrong = task.axis == AXES[3] and task.effects == ("compression",)
    alarm = not task.effects and task.seed % 10 == 0
    verdict = "NAMED" if task.effects else "AMBIGUOUS" if alarm else "ADEQUATE"
    named = ["tibia_frame"] if wrong else list(task.effects)
    return {
        "effects": list(task.effects),
        "signal": 9.0,
        "seed": task.seed,
        "verdict": verdict,
        "causes": named,
        "wrong": wrong,
        "correct": not wrong and not alarm,
        "in_group": not wrong,
    }


def test_every_axis_has_the_same_cases(row: Any) -> None:
    tasks = row._tasks()
    assert {tuple(x.axis for x in one) for one in tasks} == {AXES}
    for one in tasks:
        assert len({(x.seed, x.effects, x.subject) for x in one}) == 1
        signals = {x.signal for x in one if x.axis not in (PRIOR, TWICE)}
        assert len(signals) == 1
        assert {x.signal for x in one if x.axis in (PRIOR, TWICE)} == {None}
    seeds = [one[0].seed for one in tasks]
    assert len(set(seeds)) == len(seeds)
    counts = Counter(x.effects for (x, *_) in tasks)
    assert counts.pop(()) >= 60
    assert set(counts) == {(x,) for x in LISTED}
    assert sum(counts.values()) >= 150


def test_parts_grow_all_axes_together_and_say_how_far_they_are(row: Any) -> None:
    rows = list(row.parts(argparse.Namespace(workers=1)))
    assert len(rows) == row.N_PARTS
    counts = [[x.value for x in made.measures if "hidden effect" in x.what] for made in rows]
    for one in counts:
        assert len(one) == len(AXES)
        assert max(one) - min(one) <= 2
    assert [x[0] for x in counts] == sorted(x[0] for x in counts)
    assert rows[0].notes[0] == f"unfinished: 1 of {row.N_PARTS} parts"
    assert not any("unfinished" in x for x in rows[-1].notes)


def test_shares_are_of_the_axis_they_are_named_after(row: Any) -> None:
    (*_, last) = row.parts(argparse.Namespace(workers=1))
    found = {x.what: x for x in last.measures}
    n_hidden = len([x for x in row._tasks() if x[0].effects])
    n_compression = len([x for x in row._tasks() if x[0].effects == ("compression",)])
    for axis in AXES:
        made = found[f"{axis}: cases with a hidden effect"]
        # Where a signal is wanted, two cases were not made.
        assert made.value == n_hidden - (0 if axis in (PRIOR, TWICE) else 2)
        wrong = found[f"{axis}: wrong single name"]
        assert wrong.count == made.value
        wanted = n_compression / made.value if axis == AXES[3] else 0.0
        assert wrong.value == pytest.approx(wanted)
        assert wrong.bar == 0.03
        alarms = found[f"{axis}: false alarms"]
        assert alarms.count == 60
        assert 0.0 < alarms.value < 0.2
        assert alarms.bar == 0.08
        assert found[f"{axis}: right single name"].value == pytest.approx(1.0 - wanted)
    told = [x for x in last.notes if "wrong name" in x]
    assert len(told) == n_compression
    assert all(x.startswith(AXES[3]) for x in told)
    assert len([x for x in last.notes if "no case" in x]) == 2 * (len(AXES) - 2)
