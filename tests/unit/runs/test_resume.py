import json
import math
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identknee.runs import store as resume
from identknee.runs.errors import InputError
from identknee.runs.executors import WorkerTerminated, process_pool, threads
from identknee.runs.record import Outcome, versions
from identknee.runs.store import finish_work, open_work, resumable_map

ABOUT = {
    "inputs": {"laxity.csv": "a" * 64, "subject": "b" * 64},
    "settings": {"method": "complex", "n_starts": 100, "sd": [0.5, math.nan]},
    "seed": 0,
}


def uneven(power: int, x: float) -> dict[str, Any]:
    """Something with every kind of value that a result may hold."""
    return {
        "theta": np.array([x, math.exp(x), -0.0]) ** power,
        "objective": math.inf if x > 2 else 1 / 3,
        "missing": math.nan,
        "outcome": Outcome.FOLD,
        "pair": (np.float64(x), np.int64(7)),
    }


def die(x: int) -> int:
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


class Counting:
    """A serial executor that counts, and is interrupted after some items."""

    def __init__(self, stop_after: float = math.inf) -> None:
        self.n = 0
        self.stop_after = stop_after

    def map(self, function: Callable[[Any], Any], items: Iterable[Any], /) -> Iterator[Any]:
        for item in items:
            if self.n >= self.stop_after:
                raise KeyboardInterrupt
            self.n += 1
            yield function(item)


def test_fresh_and_stored_results_are_the_same_bits(tmp_path: Path) -> None:
    items = [0.1, 1.7, 2.5, 1e-9]
    function = partial(uneven, 3)
    expected = json.dumps(resumable_map(function, items))
    with open_work(tmp_path / "work.sqlite", ABOUT) as store:
        assert json.dumps(resumable_map(function, items, store=store, name="s")) == expected
        with process_pool(2) as processes, threads(2) as pool:
            for executor in (processes, pool):
                found = resumable_map(function, items, executor=executor, name="s")
                assert json.dumps(found) == expected
    with open_work(tmp_path / "work.sqlite", ABOUT) as store:
        counting = Counting()
        found = resumable_map(function, items, executor=counting, store=store, name="s")
        assert json.dumps(found) == expected
        assert counting.n == 0
        other = resumable_map(function, items[:2], executor=counting, store=store, name="other")
        assert counting.n == 2
        assert json.dumps(other) == json.dumps(json.loads(expected)[:2])


def test_an_interrupted_map_goes_on_where_it_was(tmp_path: Path) -> None:
    items = [float(x) for x in range(10)]
    path = tmp_path / "work.sqlite"
    with open_work(path, ABOUT) as store, pytest.raises(KeyboardInterrupt):
        resumable_map(math.sqrt, items, executor=Counting(stop_after=7), store=store, name="s")
    counting = Counting()
    with open_work(path, ABOUT) as store:
        found = resumable_map(math.sqrt, items, executor=counting, store=store, name="s")
    assert found == [math.sqrt(x) for x in items]
    assert counting.n == 3


def test_a_run_that_goes_on_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_work(tmp_path / "work.sqlite", ABOUT) as store:
        with pytest.raises(KeyboardInterrupt):
            resumable_map(abs, range(8), executor=Counting(stop_after=3), store=store)
        assert "resumed" not in capsys.readouterr().err
        resumable_map(abs, range(8), store=store, description="fitting")
        said = capsys.readouterr().err
        assert said.startswith("identknee: fitting: ")
        assert re.findall(r"\d+", said) == ["3", "8"]
        assert said.count("\n") == 1
        resumable_map(abs, range(8), store=store)
        assert capsys.readouterr().err == ""


def test_an_error_in_one_item_keeps_those_before_it(tmp_path: Path) -> None:
    with open_work(tmp_path / "work.sqlite", ABOUT) as store:
        with pytest.raises(ValueError, match=r"math domain|nonnegative"):
            resumable_map(math.sqrt, [4.0, 9.0, -1.0], store=store, name="s")
        assert [store.get(f"s/{i}") for i in range(3)] == [2.0, 3.0, None]


def test_many_items_go_in_waves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resume, "WAVE", 4)
    assert resumable_map(math.sqrt, [float(x) for x in range(11)]) == [
        math.sqrt(x) for x in range(11)
    ]
    assert resumable_map(math.sqrt, []) == []


def test_finished_work_is_on_disk_long_before_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resume, "COMMIT_S", 0.0)
    path = tmp_path / "work.sqlite"
    seen: list[set[str]] = []

    def look(x: int) -> int:
        with sqlite3.connect(path) as other:
            seen.append({key for (key,) in other.execute("SELECT key FROM rows")})
        other.close()
        return x

    with open_work(path, ABOUT) as store:
        resumable_map(look, [0, 1, 2], store=store, name="s")
    assert seen[2] == {"about", "seconds", "s/0", "s/1"}


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX systems")
def test_a_dead_worker_is_a_sentence_and_what_was_done_is_kept(tmp_path: Path) -> None:
    with open_work(tmp_path / "work.sqlite", ABOUT) as store:
        with (
            process_pool(2) as executor,
            pytest.raises(WorkerTerminated, match=r"fewer workers") as e,
        ):
            resumable_map(die, list(range(6)), executor=executor, store=store, name="s")
        assert "memory" in str(e.value)
        kept = {key: store.get(key) for key in store.keys() - {"about", "seconds"}}
        assert kept.items() <= {f"s/{i}": i for i in range(3)}.items()
        found = resumable_map(float, list(range(6)), store=store, name="s")
        assert found == list(range(6))


def test_a_large_function_is_sent_to_each_worker_once() -> None:
    ballast = Ballast(np.arange(10.0))
    with process_pool(2) as executor:
        assert resumable_map(ballast, [1, 2] * 20, executor=executor) == [1.0, 2.0] * 20
        # Asked a second time, no worker needs it again.
        loads = resumable_map(count_loads, [0] * 20, executor=executor)
        resumable_map(ballast, [1, 2] * 20, executor=executor)
        assert max(resumable_map(count_loads, [0] * 20, executor=executor)) == max(loads) == 1


class Ballast:
    n_loads = 0

    def __init__(self, values: np.ndarray[Any, Any]) -> None:
        self.values = values

    def __call__(self, index: int) -> float:
        return float(self.values[index])

    def __setstate__(self, state: dict[str, Any]) -> None:
        Ballast.n_loads += 1
        self.__dict__ |= state


def count_loads(_: int) -> int:
    time.sleep(0.01)
    return Ballast.n_loads


def test_a_full_disk_is_a_sentence_and_what_was_kept_stays(tmp_path: Path) -> None:
    items = [f"{x}" * 20_000 for x in range(10)]
    path = tmp_path / "work.sqlite"
    with open_work(path, ABOUT) as store:
        resumable_map(str, items[:2], store=store, name="s")
        store._connection.execute("PRAGMA max_page_count = 20")
        with pytest.raises(InputError, match=r"work\.sqlite.*full"):
            resumable_map(str, items, store=store, name="s")
    with open_work(path, ABOUT) as store:
        counting = Counting()
        assert resumable_map(str, items, executor=counting, store=store, name="s") == items
        assert counting.n == 8


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"inputs": {"laxity.csv": "c" * 64, "subject": "b" * 64}},
            r"asked: the content of inputs\.laxity\.csv has changed\. Give the inputs",
        ),
        (
            {"settings": {"method": "least-squares", "n_starts": 100, "sd": [0.5, math.nan]}},
            r'settings\.method was "complex" and is "least-squares" now\. Give',
        ),
        ({"seed": 1}, "seed was 0 and is 1 now"),
        (
            {"settings": {"method": "complex", "n_starts": 100}},
            r"settings\.sd was \[0\.5, NaN\] and is not given now",
        ),
        ({"priors": True}, "priors was not given and is true now"),
    ],
)
def test_a_store_about_something_else_is_refused(
    tmp_path: Path, change: Mapping[str, Any], sentence: str
) -> None:
    path = tmp_path / "work.sqlite"
    open_work(path, ABOUT).close()
    with pytest.raises(InputError, match=sentence):
        open_work(path, {**ABOUT, **change})
    open_work(path, ABOUT).close()


def test_all_that_changed_is_named(tmp_path: Path) -> None:
    path = tmp_path / "work.sqlite"
    open_work(path, ABOUT).close()
    with pytest.raises(InputError) as e:
        open_work(path, {**ABOUT, "seed": 4, "inputs": {}})
    for place in ("inputs.laxity.csv", "inputs.subject", "seed"):
        assert place in e.value.why


def test_a_store_of_another_version_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "work.sqlite"
    with monkeypatch.context() as context:
        context.setattr(resume, "versions", lambda: {"identknee": "0.0.9"})
        open_work(path, ABOUT).close()
    with pytest.raises(InputError, match=rf"0\.0\.9.*{re.escape(versions()['identknee'])}"):
        open_work(path, ABOUT)


def test_a_store_of_another_format_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "work.sqlite"
    with monkeypatch.context() as context:
        context.setattr(resume, "STORE_FORMAT", 2)
        open_work(path, ABOUT).close()
    with pytest.raises(InputError, match=r"format 2.* format 1"):
        open_work(path, ABOUT)
    with sqlite3.connect(path) as other:
        other.execute("UPDATE rows SET key = 'something'")
    other.close()
    with pytest.raises(InputError, match="format None"):
        open_work(path, ABOUT)


SCRIPT = """
import signal, sys, time
from identknee.runs.executors import process_pool
from identknee.runs.store import open_work, resumable_map

def slowly(x):
    print(x, flush=True)
    time.sleep(0.3)
    return x

if __name__ == "__main__":
    # A shell starts what runs in its background with Ctrl-C ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with open_work(sys.argv[1], {}) as store, process_pool(2) as executor:
        resumable_map(slowly, list(range(100)), executor=executor, store=store, name="s")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent to a POSIX process group")
def test_ctrl_c_keeps_what_was_finished(tmp_path: Path) -> None:
    script, path = tmp_path / "script.py", tmp_path / "work.sqlite"
    script.write_text(SCRIPT)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    with subprocess.Popen(
        [sys.executable, str(script), str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        start_new_session=True,
        text=True,
    ) as run:
        assert run.stdout is not None
        assert run.stderr is not None
        for _ in range(8):
            run.stdout.readline()
        os.killpg(run.pid, signal.SIGINT)
        error = run.stderr.read()
    assert "KeyboardInterrupt" in error
    with open_work(path, {}) as store:
        found = [store.get(f"s/{i}") for i in range(100)]
    n_kept = len([x for x in found if x is not None])
    assert n_kept >= 4
    assert found == [*range(n_kept), *[None] * (100 - n_kept)]


def test_finished_work_makes_room_for_other_work(tmp_path: Path) -> None:
    path = tmp_path / "work.sqlite"
    with open_work(path, {"seed": 1}) as store:
        resumable_map(abs, [-1, -2], store=store, name="first")
    with pytest.raises(InputError, match=r"seed was 1.* 2 "):
        open_work(path, {"seed": 2})
    finish_work(path)
    with open_work(path, {"seed": 1}) as store:
        assert "first/0" in store.keys()  # noqa: SIM118 - a store is no mapping
    finish_work(path)
    with open_work(path, {"seed": 2}) as store:
        assert "first/0" not in store.keys()  # noqa: SIM118
    with pytest.raises(InputError, match=r"seed was 2.* 1 "):
        open_work(path, {"seed": 1})


def test_time_of_a_run_that_was_stopped_is_counted_by_the_next(tmp_path: Path) -> None:
    path = tmp_path / "work.sqlite"
    with open_work(path, {}) as store:
        assert store.earlier_s == 0.0
        with pytest.raises(ZeroDivisionError):
            resumable_map(_slowly, [2, 1, 0], store=store)
    with open_work(path, {}) as store:
        first = store.earlier_s
        assert 0.2 <= first < 20.0
        assert store.seconds >= first
        resumable_map(_slowly, [2, 1], store=store)
    with open_work(path, {}) as store:
        # Nothing was left to do.
        assert store.earlier_s == first


def _slowly(x: int) -> float:
    time.sleep(0.1)
    return 1.0 / x
