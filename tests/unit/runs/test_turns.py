"""One process makes a file while others wait, and a killed one is not waited for."""

import os
import platform
import threading
import time
from pathlib import Path

import pytest

from identknee.runs import turns
from identknee.runs.turns import in_turn

# Of no process, as numbers end at 2**22, and of the first one.
ENDED, RUNNING = 2**22 + 1, 1


def test_a_second_one_waits_and_finds_what_the_first_made(tmp_path: Path) -> None:
    place, found, is_begun = tmp_path / "made", [], threading.Event()

    def second() -> None:
        is_begun.set()
        with in_turn(place):
            found.append(place.read_text())

    with in_turn(place):
        waiting = threading.Thread(target=second)
        waiting.start()
        is_begun.wait()
        time.sleep(3 * turns.PAUSE_S)
        assert found == []
        place.write_text("whole")
    waiting.join()
    assert found == ["whole"]
    assert list(tmp_path.iterdir()) == [place]


def test_the_turn_ends_with_an_error(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), in_turn(tmp_path / "made"):
        raise ZeroDivisionError
    with in_turn(tmp_path / "made"):
        pass


@pytest.mark.parametrize(
    ("process", "machine", "age_s"),
    [(ENDED, platform.node(), 0.0), (RUNNING, "elsewhere", 2 * turns.PATIENCE_S)],
)
def test_a_killed_process_is_not_waited_for(
    process: int, machine: str, age_s: float, tmp_path: Path
) -> None:
    mark = tmp_path / "made.turn"
    mark.write_text(f"{process} {machine}")
    then = time.time() - age_s
    os.utime(mark, (then, then))
    began = time.monotonic()
    with in_turn(tmp_path / "made"):
        assert mark.read_text() == f"{os.getpid()} {platform.node()}"
    assert time.monotonic() - began < turns.PATIENCE_S / 2
    assert not mark.exists()


def test_a_mark_that_cannot_be_removed_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mark = tmp_path / "made.turn"
    mark.write_text(f"{ENDED} {platform.node()}")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError

    monkeypatch.setattr(Path, "unlink", refuse)
    began = time.monotonic()
    with in_turn(tmp_path / "made"):
        assert mark.exists()
    assert time.monotonic() - began < turns.PATIENCE_S / 2


def test_where_no_mark_can_be_left_nobody_waits(tmp_path: Path) -> None:
    with in_turn(tmp_path / "missing" / "made"), in_turn(tmp_path / "missing" / "made"):
        pass
