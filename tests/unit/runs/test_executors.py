import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from textwrap import indent

import numpy as np
import pytest
from killed_commands import is_running

from identknee.runs.crash_report import are_warnings_redirected, warnings_to_log
from identknee.runs.executors import process_pool, serial, spawn_seeds, threads


def draw(seed: np.random.SeedSequence) -> tuple[float, ...]:
    values = np.random.default_rng(seed).standard_normal(50)
    return (*(float(x) for x in np.exp(values)), float(values @ values))


def fail(item: int) -> int:
    raise ValueError(f"item {item}")


def test_every_executor_gives_the_same_bits_in_the_same_order() -> None:
    seeds = spawn_seeds(7, 9)
    expected = list(serial.map(draw, seeds))
    with threads(2) as executor:
        assert list(executor.map(draw, seeds)) == expected
    with process_pool(2) as executor:
        assert list(executor.map(draw, seeds)) == expected
        with pytest.raises(ValueError, match="item 1"):
            list(executor.map(fail, [1]))


def has_log(_: int) -> bool:
    return are_warnings_redirected()


def test_warnings_of_workers_go_where_those_of_the_parent_go() -> None:
    with process_pool(2) as executor:
        assert list(executor.map(has_log, [0])) == [False]
    with warnings_to_log(), process_pool(2) as executor:
        assert list(executor.map(has_log, [0])) == [True]


def test_one_worker_needs_no_pool() -> None:
    with process_pool(1) as executor, threads(1) as other:
        assert executor is serial
        assert other is serial


def test_no_workers_is_a_mistake() -> None:
    for pool in (process_pool, threads):
        with pytest.raises(ValueError, match=" 1, got 0"), pool(0):
            pass


def test_seeds_are_a_function_of_the_seed_alone() -> None:
    parent = np.random.SeedSequence(3)
    again = [spawn_seeds(3, 2), spawn_seeds(parent, 2), spawn_seeds(parent, 3)[:2]]
    states = [[tuple(s.generate_state(4)) for s in seeds] for seeds in again]
    assert states[0] == states[1] == states[2]
    assert states[0][0] != states[0][1]
    child = spawn_seeds(3, 2)[0]
    assert spawn_seeds(child, 1)[0].spawn_key == (0, 0)


def test_busy_workers_do_not_hold_up_an_exception() -> None:
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        stop_after_the_first([0.0, 60.0, 60.0, 60.0])
    assert time.monotonic() - began < 30


def stop_after_the_first(naps_s: list[float]) -> None:
    with process_pool(2) as executor:
        for _ in executor.map(time.sleep, naps_s):
            raise KeyboardInterrupt


SCRIPT = """
import os, sys, time
from identknee.runs.executors import process_pool

if __name__ == "__main__":
    with process_pool(2) as executor:
        print(next(iter(executor.map(eval, ["__import__('os').getpid()"]))), flush=True)
        time.sleep(60)
"""
BUSY_SCRIPT = """
import os
from identknee.runs.executors import process_pool

def hold(_):
    print(os.getpid(), flush=True)
    while True:
        pass

if __name__ == "__main__":
    with process_pool(2) as executor:
        list(executor.map(hold, [0]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX systems")
def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    worker = worker_of_a_killed_parent(SCRIPT, tmp_path)
    assert not is_running(worker)
    assert list(tmp_path.iterdir()) == [tmp_path / "script.py"], "the function's file is left"


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX systems")
def test_busy_workers_end_too(tmp_path: Path) -> None:
    assert not is_running(worker_of_a_killed_parent(BUSY_SCRIPT, tmp_path))


def worker_of_a_killed_parent(text: str, tmp_path: Path) -> int:
    """Process of the first worker, when it has ended or should have."""
    script = tmp_path / "script.py"
    script.write_text(text)
    root = str(Path(__file__).parents[3])
    environment = {**os.environ, "PYTHONPATH": root, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, env=environment, text=True
    ) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 20
    while is_running(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    return worker


IMPORTS = "import os\nfrom identknee.runs.executors import process_pool\n"
USE = "with process_pool(2) as executor:\n    list(executor.map(abs, [1, -2]))\n"
DYING = USE.replace("abs", "os._exit")


@pytest.mark.parametrize(
    ("text", "has_trace", "word"),
    [
        (USE, False, "__main__"),
        (f"def main():\n{indent(USE, '    ')}\nmain()", False, "__main__"),
        (f"try:\n{indent(USE, '    ')}\nexcept OSError:\n    pass", False, "__main__"),
        (f"if __name__ == '__mp_main__':\n    raise OSError\n{USE}", True, "could start"),
        (f"if __name__ == '__main__':\n{indent(DYING, '    ')}", False, "out of memory"),
    ],
)
def test_workers_that_cannot_import_their_script_are_told_from_those_that_die(
    tmp_path: Path, text: str, *, has_trace: bool, word: str
) -> None:
    script = tmp_path / "script.py"
    script.write_text(f"{IMPORTS}{text}")
    ended = _ended([str(script)], tmp_path)
    last = ended.stderr.strip().splitlines()[-1]
    assert last.startswith("identknee.runs.executors.WorkerTerminated")
    assert word in last
    # The parent's own trace has two parts; workers add none where the guard is missing.
    assert (ended.stderr.count("spawn_main") > 0) is has_trace


def test_a_script_that_is_no_file_is_named(tmp_path: Path) -> None:
    ended = _ended(["-"], tmp_path, given=f"{IMPORTS}{USE}")
    last = ended.stderr.strip().splitlines()[-1]
    assert last.startswith("identknee.runs.executors.WorkerTerminated")
    assert "as a file" in last


def _ended(
    arguments: list[str], folder: Path, given: str | None = None
) -> subprocess.CompletedProcess[str]:
    root = str(Path(__file__).parents[3])
    return subprocess.run(
        [sys.executable, *arguments],
        input=given,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": root, "TMPDIR": str(folder)},
        text=True,
        check=False,
        timeout=120,
    )
