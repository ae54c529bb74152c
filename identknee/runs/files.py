"""Files checked before they are read, and written whole or not at all."""

import errno
import hashlib
import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from identknee.runs.errors import InputError

PathLike = str | os.PathLike[str]
BYTES_PER_MB = 10**6
BACKSLASH = "Write paths with /, or in TOML between single quotes: 'C:\\data\\femur.ply'."
# What a backslash makes of the letter after it in TOML and Python, and the drive of a Windows path.
_ESCAPED = {"\b": r"\b", "\f": r"\f", "\t": r"\t", "\r": r"\r", "\n": r"\n"}
_DRIVE = re.compile(r"(.*[\\/])?[A-Za-z]:")
# The process that writes it is part of the name of an unfinished file.
_PART = re.compile(r"\.(\d+)-\w{8}\.part$")


def write_atomically(path: PathLike, content: str | bytes) -> Path:
    """Path of a file that now holds `content`, and that never held a part of it.

    The content goes to a temporary name in the same folder, reaches the disk, and is then renamed.
    Text is written as UTF-8 with the line ends it has.

    Raises
    ------
    InputError
        If it cannot be written: no such folder, no permission, a full disk. What stood there
        before is left as it was, and the temporary file is removed.
    """
    target = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    temporary = temporary_path_beside(target)
    try:
        try:
            with temporary.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(target, error) from error
    return target


def prepare_folder(path: PathLike) -> Path:
    """Path of a folder that exists, made where it is missing, and can be written to.

    Parts of files that a killed process left in it are removed.

    Raises
    ------
    InputError
        If it cannot be made or written to, or is a file.
    """
    folder = Path(path)
    probe = temporary_path_beside(folder / "probe")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            probe.touch()
        finally:
            probe.unlink(missing_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(
            folder, "", "a file stands where the folder should be", "Choose another folder name."
        ) from error
    except OSError as error:
        raise _unwritable(folder, error) from error
    for part in folder.glob(".*.part"):
        found = _PART.search(part.name)
        if found is None or is_running(int(found[1])):
            continue
        with suppress(OSError):
            if part.is_dir():
                shutil.rmtree(part)
            else:
                part.unlink()
    return folder


def temporary_path_beside(path: PathLike) -> Path:
    """Path in the same folder for what is to become `path` once it is whole.

    What a killed process leaves under such a name goes when the folder is next prepared.
    """
    target = Path(path)
    return target.with_name(f".{target.name[:100]}.{os.getpid()}-{secrets.token_hex(4)}.part")


def whatever_case(folder: Path, parts: Sequence[str]) -> Path | None:
    """The file below a folder, its path as written or else in another case; None if not found."""
    if not parts:
        return folder if folder.is_file() else None
    if (folder / parts[0]).exists() or parts[0] == "..":
        return whatever_case(folder / parts[0], parts[1:])
    try:
        names = sorted(x.name for x in folder.iterdir())
    except OSError:
        return None
    alike = [x for x in names if x.casefold() == parts[0].casefold()]
    ways = (whatever_case(folder / x, parts[1:]) for x in alike)
    return next((x for x in ways if x is not None), None)


def check_readable(path: PathLike, limit_mb: float = 512) -> Path:
    """Path of a file that can be read: it is there, holds something and is not too large.

    Raises
    ------
    InputError
        If it is missing, a folder, empty, too large or may not be read.
    """
    file = Path(path)
    text = os.fspath(file)
    made = [word for x, word in _ESCAPED.items() if x in text]
    # A text of several lines was given for a path, unless it begins with a drive.
    is_path = not {r"\r", r"\n"} & set(made) or _DRIVE.match(text)
    if made and is_path and not os.path.exists(text):  # noqa: PTH110 - no error where it is long
        why = f"there is no such file: {made[0]} in its path is one special character"
        raise InputError(repr(text), "", why, BACKSLASH)
    first, *more = text.splitlines() or [""]
    if more:
        why = f"this is a text of {1 + len(more)} lines, not the path of a file"
        raise InputError(f"{first[:40]}...", "", why, "Save it to a file and give its path.")
    try:
        is_folder, size = file.is_dir(), file.stat().st_size
        if not is_folder:
            with file.open("rb"):
                pass
    except FileNotFoundError as error:
        raise InputError(
            file, "", "there is no such file", "Check the spelling and the folder."
        ) from error
    # A path with a null character is a ValueError.
    except ValueError as error:
        raise InputError(
            repr(os.fspath(file)), "", "this is not a valid path", "Check the spelling."
        ) from error
    except OSError as error:
        reason = _reason(error)
        raise InputError(
            file, "", f"the file cannot be read ({reason})", "Check its permissions."
        ) from error
    if is_folder:
        raise InputError(
            file, "", "this is a folder, not a file", "Give the path of the file in it."
        )
    if size > limit_mb * BYTES_PER_MB:
        raise InputError(
            file,
            "",
            f"the file has {size / BYTES_PER_MB:.0f} MB, more than the {limit_mb:g} MB allowed",
            "Check that it is the right file, or thin or split it.",
        )
    if size == 0:
        raise InputError(file, "", "the file is empty", "Write or export it again.")
    return file


def digest(source: PathLike | bytes) -> str:
    """SHA-256 of a file (given by its path) or of bytes, as 64 hexadecimal digits.

    Examples
    --------
    >>> digest(b"")[:8]
    'e3b0c442'
    """
    if isinstance(source, bytes):
        return hashlib.sha256(source).hexdigest()
    with check_readable(source, math.inf).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_json(path: PathLike, mapping: Mapping[str, Any]) -> Path:
    """Path of a JSON file that now holds `mapping`; numbers are the shortest that read back equal.

    JSON has no infinity and no NaN, so both become ``null``.

    Raises
    ------
    InputError
        If the file cannot be written.
    TypeError
        If a value has no JSON form.
    """
    text = json.dumps(plain(mapping), indent=2, ensure_ascii=False, allow_nan=False)
    return write_atomically(path, text + "\n")


def plain(value: Any, *, keep_nonfinite: bool = False) -> Any:
    """`value` in the types JSON knows: arrays as lists, enums by value, paths as text.

    Parameters
    ----------
    value
        Numbers, text, arrays, enums, paths, and mappings and sequences of them.
    keep_nonfinite
        Whether infinity and NaN stay as they are; they become None otherwise.

    Raises
    ------
    TypeError
        If a value has no JSON form.

    Examples
    --------
    >>> plain({"theta": np.array([1.5, np.inf])})
    {'theta': [1.5, None]}
    """
    if isinstance(value, Enum):
        return plain(value.value, keep_nonfinite=keep_nonfinite)
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist(), keep_nonfinite=keep_nonfinite)
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if keep_nonfinite or math.isfinite(value) else None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {
            str(plain(key)): plain(item, keep_nonfinite=keep_nonfinite)
            for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [plain(item, keep_nonfinite=keep_nonfinite) for item in value]
    raise TypeError(f"{value!r} of type {type(value).__name__} has no JSON form")


def is_running(process: int) -> bool:
    """Whether a process of this machine is running; not known on Windows, and False there."""
    if os.name == "nt":
        return False
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


_FULL = (
    "the disk is full",
    "Free some space or write to another disk; nothing half-written was left.",
)
FORBIDDEN = (
    "it may not be written to ({})",
    "Choose another folder with --out, or change the permissions.",
)
_MIXED_UP = "a file and a folder are mixed up in this path ({})", "Choose another name."
# Why something cannot be written, and the remedy, by the system's code.
_UNWRITABLE = {
    errno.ENOSPC: _FULL,
    errno.EDQUOT: _FULL,
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), FORBIDDEN),
    errno.ENOENT: ("its folder does not exist", "Make the folder first or choose another."),
    errno.EISDIR: _MIXED_UP,
    errno.ENOTDIR: _MIXED_UP,
}


def _unwritable(path: Path, error: OSError) -> InputError:
    other = "it cannot be written ({})", "Choose another place."
    why, remedy = _UNWRITABLE.get(error.errno or 0, other)
    return InputError(path, "", why.format(_reason(error)), remedy)


def _reason(error: OSError) -> str:
    return (error.strerror or type(error).__name__).lower()


@cache
def cache_folder() -> Path:
    """The folder for everything that can be computed again, ``IDENTKNEE_CACHE`` if that is set."""
    return Path(os.environ.get("IDENTKNEE_CACHE") or user_cache_path("identknee"))
