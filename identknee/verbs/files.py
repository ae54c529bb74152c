"""Answers as two files, and back: a flat summary for people and checks, and all arrays."""

import gc
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import xarray

from identknee.runs.array_groups import axis_fault, groups_of, with_arrays
from identknee.runs.errors import InputError
from identknee.runs.files import (
    PathLike,
    digest,
    plain,
    temporary_path_beside,
    write_atomically,
    write_json,
)
from identknee.runs.schema import Fault, from_plain, read_json, shown, summary_of
from identknee.verbs.answer import Answer
from identknee.verbs.registry import verb_named

SUMMARY, ARRAYS = "result.json", "result.nc"
AGAIN = "Run the command that made it again."
Given = TypeVar("Given", bound=Answer)
# Made of other fields, in the words of the version that reads them.
PROSE = ("sentence", "meaning", "source", "reason")


def write_answer(folder: Path, answer: Given) -> Given:
    """The answer, as now written to `result.json` and `result.nc`.

    Raises
    ------
    InputError
        If a file cannot be written; neither is left half-written.
    """
    record = answer.record
    if record is None:
        raise ValueError("only what a verb gave back can be written: it knows how it was made")
    # The summary comes last: where it stands the arrays stand too.
    content = _write_arrays(folder / ARRAYS, answer)
    written = replace(answer, record=replace(record, arrays=digest(content)))
    write_json(folder / SUMMARY, summary_of(written))
    return written


def load(path: PathLike) -> Answer:
    """What a verb left in a folder, as the verb gave it back.

    Parameters
    ----------
    path
        The folder ``--out`` of a verb, or ``result.json`` in it.

    Raises
    ------
    InputError
        If there is no result, it is of a verb without one, or a file is damaged.
    """
    file = Path(path)
    file = file / SUMMARY if file.is_dir() else file
    summary = read_json(file, AGAIN)
    record = summary.get("record") if isinstance(summary, dict) else None
    verb = record.get("verb") if isinstance(record, dict) else None
    known = verb_named(verb)
    if known is None:
        raise InputError(file, "record/verb", f"{shown(verb)} is no verb with a result", AGAIN)
    cls: type[Answer] = known.answer_class
    return loaded(file, summary, cls)


def loaded(file: Path, summary: Mapping[str, Any], cls: type[Given]) -> Given:
    """The answer of this class, of a summary that was read from `file`; as `load`."""
    arrays = file.with_name(ARRAYS)
    groups = _groups(arrays, summary["record"].get("arrays"))
    if fault := axis_fault(cls, groups):
        raise InputError(arrays, f"group {fault[0]}", fault[1], AGAIN)

    def refuse(fault: Fault) -> InputError:
        where = "/".join(str(x) for x in (*fault.place, *([fault.key] * bool(fault.key))))
        return InputError(file, where, fault.why, fault.remedy or AGAIN)

    try:
        answer: Given = from_plain(cls, with_arrays(cls, dict(summary), groups), refuse)
    # What mutated files hold may be of any kind where a table or a list should stand.
    except (AttributeError, IndexError, KeyError, TypeError) as error:
        raise InputError(file, "", f"it does not fit its arrays ({error})", AGAIN) from error
    again = plain(summary_of(answer))
    for key, value in again.items():
        # A result of an earlier version lacks what was added since.
        if key not in summary:
            continue
        if key not in ("record", *PROSE) and not _is_same(summary.get(key), value):
            raise InputError(file, key, "it does not agree with the rest of the result", AGAIN)
    return answer


def _is_same(stored: Any, again: Any) -> bool:
    """Whether both say the same, in whatever words."""
    if isinstance(stored, dict) and isinstance(again, dict):
        # A result of an earlier version lacks what was added since.
        wanted = {key for key, value in again.items() if key in stored or value}
        return stored.keys() == wanted and all(
            key in PROSE or _is_same(stored[key], again[key]) for key in wanted
        )
    if isinstance(stored, list) and isinstance(again, list):
        return len(stored) == len(again) and all(map(_is_same, stored, again))
    return bool(stored == again)


def _write_arrays(path: Path, answer: Answer) -> bytes:
    """The bytes now written."""
    tree = xarray.DataTree.from_dict(groups_of(answer))
    if (record := answer.record) is not None:
        tree.attrs = {
            "verb": record.verb,
            "started": record.started,
            "versions": ", ".join(f"{name} {x}" for name, x in record.versions.items()),
        }
    # The library writes to paths only; its file becomes bytes that are written whole or not at all.
    temporary = temporary_path_beside(path)
    try:
        tree.to_netcdf(temporary, engine="h5netcdf")
        content = temporary.read_bytes()
    except OSError as error:
        remedy = "Free some space or choose another folder with --out."
        raise InputError(path, "", f"it cannot be written ({error})", remedy) from error
    finally:
        temporary.unlink(missing_ok=True)
    write_atomically(path, content)
    return content


def _groups(path: Path, sha: Any) -> dict[str, xarray.Dataset]:
    if digest(path) != sha:
        why = "it is not the file that was written with result.json"
        raise InputError(path, "", why, AGAIN)
    with warnings.catch_warnings(), _silenced_netcdf_close():
        warnings.simplefilter("ignore")
        try:
            with xarray.open_datatree(path, engine="h5netcdf") as tree:
                return {name: node.to_dataset().load() for name, node in tree.children.items()}
        # The libraries below raise errors of many types at a damaged file.
        except Exception as error:  # noqa: BLE001
            why = f"the arrays cannot be read ({type(error).__name__}: {shown(str(error))})"
        # What failed may wait for its end in a circle.
        gc.collect()
    raise InputError(path, "", why, AGAIN)


@contextmanager
def _silenced_netcdf_close() -> Iterator[None]:
    """Keep off the terminal what the library prints when it closes a file it could not open."""
    shown_before = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = shown_before
