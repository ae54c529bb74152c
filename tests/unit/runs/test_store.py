import math
import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from identknee.runs.errors import InputError
from identknee.runs.store import Store


def test_values_come_back_equal_after_closing(tmp_path: Path) -> None:
    path = tmp_path / "new" / "runs.sqlite"
    values = {"theta": np.array([0.1, 1 / 3, 1e-300]), "objective": math.inf, "outcome": "fold"}
    with Store(path) as store:
        store.put_many({"a": values, "b": 1})
        store.put_many({"b": 2})
    with Store(path) as store:
        assert store.keys() == {"a", "b"}
        assert store.get("a") == {**values, "theta": [0.1, 1 / 3, 1e-300]}
        assert store.get("b") == 2
        assert store.get("c") is None


def test_a_batch_is_kept_whole_or_not_at_all(tmp_path: Path) -> None:
    with Store(tmp_path / "runs.sqlite") as store:
        store.put_many({"a": 1})
        with pytest.raises(TypeError):
            store.put_many({"b": 2, "c": object()})
        assert store.keys() == {"a"}


SCRIPT = """
import os, signal, sys
from identknee.runs.store import Store

store = Store(sys.argv[1])
store.put_many({"done": [1.5]})
store._connection.execute("BEGIN")
store._connection.execute("INSERT INTO rows VALUES ('half', '1', '')")
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX systems")
def test_a_kill_loses_only_the_batch_under_way(tmp_path: Path) -> None:
    path = tmp_path / "runs.sqlite"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    killed = subprocess.run([sys.executable, "-c", SCRIPT, str(path)], env=environment, check=False)
    assert killed.returncode == -signal.SIGKILL
    with Store(path) as store:
        assert store.keys() == {"done"}
        assert store.get("done") == [1.5]


def test_another_file_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "laxity.csv"
    path.write_text("trial,flexion_deg\n" * 100)
    with pytest.raises(InputError, match=r"laxity\.csv.*store"):
        Store(path)
    assert path.read_text() == "trial,flexion_deg\n" * 100


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"written.*--out"):
        Store(tmp_path)


def test_a_second_writer_is_told_to_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("identknee.runs.store.WAIT_S", 0.05)
    path = tmp_path / "runs.sqlite"
    with Store(path) as store:
        other = sqlite3.connect(path)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(InputError, match=r"runs\.sqlite.*another"):
            store.put_many({"a": 1})
        other.rollback()
        other.close()
        store.put_many({"a": 1})


def test_a_full_disk_is_named(tmp_path: Path) -> None:
    with Store(tmp_path / "runs.sqlite") as store:
        store._connection.execute("PRAGMA max_page_count=3")
        with pytest.raises(InputError, match=r"runs\.sqlite.*full"):
            store.put_many({"a": "x" * 100_000})
        assert store.keys() == set()


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE rows SET value = '[1.5, 2.6]'",
        "UPDATE rows SET value = '[1.5'",
        "UPDATE rows SET value = 15",
        "UPDATE rows SET value = x'ff'",
        "UPDATE rows SET value = CAST(x'ff' AS TEXT)",
        "UPDATE rows SET checksum = ''",
        "UPDATE rows SET key = 'b' WHERE key = 'a'",
        "UPDATE rows SET key = x'61' WHERE key = 'a'",
        "ALTER TABLE rows DROP COLUMN checksum",
        "DROP TABLE rows; CREATE TABLE rows (key TEXT, value TEXT)",
    ],
)
def test_what_is_damaged_never_comes_back(tmp_path: Path, change: str) -> None:
    path = tmp_path / "runs.sqlite"
    with Store(path) as store:
        store.put_many({"a": [1.5, 2.5]})
    with closing(sqlite3.connect(path)) as other:
        other.executescript(change)
    with pytest.raises(InputError, match=r"Remove|another folder"):
        use(path)


def use(path: Path) -> None:
    with Store(path) as store:
        for key in sorted(store.keys()):
            store.get(key)
        store.put_many({"c": 1})
