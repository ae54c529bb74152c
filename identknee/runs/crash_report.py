"""Crash reports for the maintainers, and warnings kept off the terminal."""

import logging
import os
import platform
import secrets
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from platformdirs import user_log_path
from typing_extensions import override

from identknee.runs.errors import InputError
from identknee.runs.files import digest, write_atomically
from identknee.runs.record import versions

LOG = "warnings.log"
LARGEST_LOG_BYTES = 10**6
# Files of an input folder that are listed at most; a subject folder has four.
MOST_FILES = 20


def log_folder() -> Path:
    """The folder of logs and crash reports, below ``IDENTKNEE_CACHE`` if that is set."""
    kept = os.environ.get("IDENTKNEE_CACHE")
    return Path(kept) / "log" if kept else user_log_path("identknee")


def report_unexpected_error(
    error: BaseException, settings: Mapping[str, Any], folder: Path | None
) -> str:
    """Sentence about an unexpected error, naming the crash report written.

    Parameters
    ----------
    error
        What was raised.
    settings
        The options of the call by name. Those that name files are listed with their digests.
    folder
        Where the report belongs; the folder of logs where there is none or it cannot be written.
    """
    what = " ".join(traceback.format_exception_only(error)[-1].split())
    sentence = f"unexpected error ({what[:200]})"
    for place in (folder, log_folder()):
        if place is None:
            continue
        try:
            if place is not folder:
                place.mkdir(parents=True, exist_ok=True)
            name = f"unforeseen-{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(2)}.txt"
            path = write_atomically(place / name, _report(error, settings))
        except (OSError, InputError):
            continue
        return f"{sentence}. Please send {path} to the maintainers of identknee"
    return f"{sentence}. Please tell the maintainers of identknee"


@contextmanager
def warnings_to_log() -> Iterator[None]:
    """Keep warnings of libraries off the terminal: they go to the log instead.

    Whoever calls the library from Python gets them as warnings.
    """
    shown, handler = warnings.showwarning, _LogHandler()
    log_warnings()
    # Without a handler of its own a library's errors are printed by the last resort.
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        warnings.showwarning = shown
        logging.getLogger().removeHandler(handler)


def log_warnings() -> None:
    """Send this process's warnings to the log from now on."""
    warnings.showwarning = _show


def are_warnings_redirected() -> bool:
    """Whether this process sends its warnings to the log."""
    return warnings.showwarning is _show


class _LogHandler(logging.Handler):
    """What libraries log as a warning or worse, in the log."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)

    @override
    def emit(self, record: logging.LogRecord) -> None:
        """Write one record."""
        with suppress(Exception):
            _note(f"{record.name}: {record.getMessage()}")


def _show(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    del file, line
    _note(f"{filename}:{lineno}: {category.__name__}: {message}")


def _note(text: str) -> None:
    # A log that cannot be written must not stop a computation.
    with suppress(OSError):
        path = log_folder() / LOG
        path.parent.mkdir(parents=True, exist_ok=True)
        is_full = path.exists() and path.stat().st_size > LARGEST_LOG_BYTES
        with path.open("w" if is_full else "a", encoding="utf-8", errors="replace") as file:
            file.write(f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S} {text}\n")


def _report(error: BaseException, settings: Mapping[str, Any]) -> str:
    inputs = [
        f"{name}: {path}, SHA-256 {sha}"
        for name, value in settings.items()
        for path, sha in _digests(value)
    ]
    lines = [
        "Unexpected error in identknee.",
        "",
        f"call: {sys.argv}",
        f"settings: {dict(settings)}",
        f"versions: {versions()}",
        f"platform: {platform.platform()}",
        *inputs,
        "",
        *traceback.format_exception(error),
    ]
    return "\n".join(lines).encode("utf-8", "replace").decode("utf-8")


def _digests(value: Any) -> Iterator[tuple[Path, str]]:
    if not isinstance(value, str | Path):
        return
    with suppress(OSError, ValueError):
        path = Path(value)
        files = sorted(path.iterdir())[:MOST_FILES] if path.is_dir() else [path]
        for file in files:
            if file.is_file():
                yield file, digest(file)
