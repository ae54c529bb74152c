"""Where the command `identknee` begins, and what Ctrl-C does to it."""

import os
import signal
import sys
from types import FrameType

from identknee.runs.executors import LIBRARY_THREADS

NOT_COMPUTED, INTERRUPTED = 1, 130
STOPPED = "identknee: stopped while starting"


def main() -> None:
    """Run the command and leave with its exit code."""
    signal.signal(signal.SIGINT, _stop)
    for variable in LIBRARY_THREADS:
        os.environ.setdefault(variable, "1")
    try:
        # Loaded here so that Ctrl-C or a missing package leaves no traceback either.
        try:
            from identknee.cli.app import app
        except ModuleNotFoundError as error:
            print(f"identknee: {error}. Install identknee again: pip install .", file=sys.stderr)
            sys.exit(NOT_COMPUTED)
        app(prog_name="identknee")
    except KeyboardInterrupt:
        print(STOPPED, file=sys.stderr)
        sys.exit(INTERRUPTED)
    # Errors outside the verbs, which handle their own.
    except Exception as error:  # noqa: BLE001
        from identknee.runs.crash_report import report_unexpected_error

        print(f"identknee: {report_unexpected_error(error, {}, None)}", file=sys.stderr)
        sys.exit(NOT_COMPUTED)


def _stop(_number: int, frame: FrameType | None) -> None:
    # Some libraries swallow whatever is raised while they are imported and then fail later. Nothing
    # is being written during an import, so there it is safe to leave at once.
    while frame is not None:
        if frame.f_globals.get("__name__") == "importlib._bootstrap":
            print(STOPPED, file=sys.stderr, flush=True)
            os._exit(INTERRUPTED)
        frame = frame.f_back
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
