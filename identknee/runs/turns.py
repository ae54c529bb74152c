"""Processes that want the same file made, one after the other."""

import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from identknee.runs.files import is_running

# Nothing that is made takes longer: a process of another machine that has not ended its turn by
# then was killed.
PATIENCE_S = 120.0
PAUSE_S = 0.05


@contextmanager
def in_turn(path: Path) -> Iterator[None]:
    """Context of the one process that makes the file at `path`; others wait until its turn ends.

    Whoever comes after looks first whether the file is there by now. Where no mark can be left
    beside the file, or none be removed, nobody waits.
    """
    mark = path.with_name(f"{path.name}.turn")
    is_marked = False
    deadline = time.monotonic() + PATIENCE_S
    while not is_marked and time.monotonic() < deadline:
        try:
            with mark.open("x", encoding="utf-8") as file:
                file.write(f"{os.getpid()} {platform.node()}")
            is_marked = True
        except FileExistsError:
            if not _wait(mark):
                break
        except OSError:
            break
    try:
        yield
    finally:
        if is_marked:
            mark.unlink(missing_ok=True)


def _wait(mark: Path) -> bool:
    """Wait a little and remove the mark of a killed process; False where it can only stay."""
    time.sleep(PAUSE_S)
    try:
        process, _, machine = mark.read_text(encoding="utf-8").partition(" ")
        is_old = time.time() - mark.stat().st_mtime > PATIENCE_S
        if is_old or (machine == platform.node() and not is_running(int(process))):
            mark.unlink(missing_ok=True)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return True
