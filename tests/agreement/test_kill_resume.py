"""Killed at any moment, the same command again ends with the bits of an undisturbed run."""

import json
import os
import sqlite3
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from killed_commands import run_for
from problems import Linear, plain_parameters

from identknee.calibrate.fit import fit
from identknee.runs import store as resume
from identknee.runs.executors import process_pool
from identknee.runs.store import open_work, resumable_map

N_STARTS, N_KILLS = 40, 2
WORK_S = 0.05  # of one start, so that kills find work under way


def fit_one(index: int) -> dict[str, object]:
    rng = np.random.default_rng(0)
    problem = Linear(
        parameters=plain_parameters(3), matrix=rng.normal(size=(9, 3)), data=rng.normal(size=9)
    )
    start = np.random.default_rng(index).uniform(-5, 5, 3)
    end = fit(problem, start, method="complex", budget=60, seed=index)
    return {"theta": end.theta, "objective": end.objective, "outcome": end.outcome}


def fit_slowly(index: int) -> dict[str, object]:
    time.sleep(WORK_S)
    return fit_one(index)


def sweep(folder: Path, workers: int) -> None:
    """Write what all the fits came to, as a verb would."""
    about = {"n_starts": N_STARTS}
    with open_work(folder / "work.sqlite", about) as store, process_pool(workers) as executor:
        ends = resumable_map(
            fit_slowly, range(N_STARTS), executor=executor, store=store, name="fits"
        )
    (folder / "result.json").write_text(json.dumps(ends))


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX systems")
def test_kills_at_random_moments_change_no_bit(tmp_path: Path) -> None:
    tests = Path(__file__).parents[1]
    path = os.pathsep.join(str(x) for x in (tests.parent, tests, tests / "support"))
    environment = {**os.environ, "PYTHONPATH": path, "TMPDIR": str(tmp_path)}
    rng = np.random.default_rng(1)
    kept: list[int] = []
    for _ in range(N_KILLS):
        # Before the workers begin, or among the starts.
        run_for([sys.executable, __file__, str(tmp_path), "2"], rng.uniform(0.5, 2.5), environment)
        kept.append(_n_kept(tmp_path / "work.sqlite"))
    assert kept == sorted(kept)
    assert run_for([sys.executable, __file__, str(tmp_path), "2"], None, environment) == 0
    expected = [resume.json_round_trip(fit_one(index)) for index in range(N_STARTS)]
    assert json.loads((tmp_path / "result.json").read_text()) == expected


def _n_kept(path: Path) -> int:
    if not path.exists():
        return 0
    connection = sqlite3.connect(path)
    (n,) = connection.execute("SELECT count(*) FROM rows WHERE key LIKE 'fits/%'").fetchone()
    connection.close()
    return int(n)


if __name__ == "__main__":
    resume.COMMIT_S = 0.1
    sweep(Path(sys.argv[1]), int(sys.argv[2]))
