"""Commands killed on the way, together with every process they started."""

import os
import signal
import subprocess
from collections.abc import Mapping, Sequence


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
