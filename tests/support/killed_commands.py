"""Commands killed on the way, together with every process they started."""

import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path


def run_for(
    command: Sequence[str], seconds: float | None, environment: Mapping[str, str] | None = None
) -> int | None:
    """Exit code of the command; None if it ran longer than `seconds` and got kill -9 for it.

    It runs in a process group of its own, so the kill takes its workers too.
    """
    with subprocess.Popen(
        command,
        env=dict(os.environ if environment is None else environment),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            return process.wait(seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return None
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise


def descendants(process: int) -> list[int]:
    """The processes that a process started, and those that these did, on Linux."""
    parents: dict[int, int] = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        # It may have ended since.
        with suppress(OSError):
            parents[int(status.parent.name)] = int(_fields(status)[1])
    found = [process]
    for one in found:
        found += [x for x, parent in parents.items() if parent == one]
    return found[1:]


def is_running(process: int) -> bool:
    """Whether it runs; a zombie whose new parent has not collected it does not."""
    status = Path(f"/proc/{process}/stat")
    if status.exists():
        with suppress(OSError):
            return _fields(status)[0] != "Z"
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return not Path("/proc").exists()


def _fields(status: Path) -> list[str]:
    """State, parent and so on."""
    return status.read_text().rsplit(")", 1)[1].split()
