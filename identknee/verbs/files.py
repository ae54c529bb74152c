"""Answers as two files, and back: a flat summary for people and checks, and all arrays."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray

from identknee.runs.declare import AXIS_NAMES, Entry, axis_names_within, entries
from identknee.runs.errors import InputError
from identknee.runs.files import (
    PathLike,
    digest,
    plain,
    temporary_path_beside,
    write_atomically,
    write_json,
)
from identknee.runs.schema import (
    from_plain,
    read_json,
    record_within,
    shown,
    summary_of,
    type_hints_of,
)
from identknee.verbs.answer import Answer
from identknee.verbs.registry import verb_named

Groups = Mapping[str, xarray.Dataset]
MAIN = "result"
# Axes along which the records of a result differ in length.
RAGGED = {"point"}
# Types of fields that stand as columns beside the arrays of stacked records.
_COLUMNS = (bool, int, float, str, Enum, type(None))


def groups_of(result: Any) -> dict[str, xarray.Dataset]:
    """Datasets by group name with every array of a result, its unit and its meaning.

    The records of a field declared with ``rows`` are stacked along that axis, their numbers and
    words beside their arrays. Where their arrays differ in length along an axis, the rest is NaN
    (-1 for whole numbers) and ``n_<axis>`` says how long each is.
    """
    variables: dict[str, dict[str, Any]] = {}
    kinds = entries(type(result)).items()
    labels = dict(
        x for name, about in kinds for x in axis_names_within(about, getattr(result, name))
    )
    for group, name, variable in _variables(result, MAIN, ""):
        own = variables.setdefault(group, {})
        if name in own and not np.array_equal(own[name][1], variable[1]):
            raise ValueError(f"two fields are stored as {name} in the group {group}")
        own[name] = variable
    return {name: _dataset(own, AXIS_NAMES | labels) for name, own in variables.items()}


def with_arrays(cls: type, plain: dict[str, Any], groups: Groups) -> dict[str, Any]:
    """What `summary_of` made of a result, its arrays put back from their groups.

    An array that is not there stays missing.
    """
    return _filled(cls, plain, groups, MAIN, "")


def axis_fault(cls: type, groups: Groups) -> tuple[str, str] | None:
    """The first axis whose names are not what they must be: its group and why; None without.

    Names that a result declares along an axis are the same in all groups and differ from one
    another; an axis that always has the same names has these.
    """
    known, named = dict(AXIS_NAMES), {*AXIS_NAMES, *_named_axes(cls)}
    for group, dataset in groups.items():
        for dim in named & set(map(str, dataset.coords)):
            names = tuple(map(str, dataset[dim].values))
            if len(set(names)) < len(names):
                return group, f"its axis {dim} names something twice"
            if known.setdefault(dim, names) != names:
                return group, f"its axis {dim} has other names than elsewhere"
    return None


def _named_axes(cls: type) -> Iterator[str]:
    """Axes whose names a result holds."""
    for name, about in entries(cls).items():
        kind, _ = record_within(type_hints_of(cls)[name])
        if about.dims and not about.is_in_arrays:
            yield about.dims[0]
        elif kind is not None:
            yield from _named_axes(kind)


def _variables(record: Any, group: str, prefix: str) -> Iterator[tuple[str, str, Any]]:
    hints = type_hints_of(type(record))
    for name, about in entries(type(record)).items():
        value, own_group, key = getattr(record, name), about.group or group, about.key or name
        kind, how = record_within(hints[name])
        is_missing = value is None or not (about.is_in_files or about.is_in_arrays)
        if is_missing or (about.dims and not about.is_in_arrays):
            continue
        if about.rows and kind is not None:
            rows = tuple(value.values()) if how == "dict" else value
            if how == "dict" and rows:
                yield own_group, about.rows, (about.rows, list(value))
            for column, variable in _columns(kind, rows, about.rows, "").items():
                yield own_group, column, variable
        elif how == "one":
            yield from _variables(value, own_group, _prefix_within(about, prefix, key))
        elif about.is_in_arrays:
            yield own_group, f"{prefix}{key}", (about.dims, _stored(value), _attributes(about))


def _prefix_within(about: Entry, prefix: str, key: str) -> str:
    """What stands before the names of the arrays of a record within another."""
    if about.is_inline:
        return prefix
    return "" if about.group else f"{prefix}{key}_"


def _columns(kind: type, records: Sequence[Any], rows: str, prefix: str) -> dict[str, Any]:
    """What a group holds of stacked records: a variable for each array, number and word."""
    hints = type_hints_of(kind)
    found: dict[str, Any] = {}
    for name, about in entries(kind).items():
        values = [getattr(x, name) for x in records]
        column = f"{prefix}{about.key or name}"
        inner, how = record_within(hints[name])
        if how == "one" and inner is not None and None not in values:
            found |= _columns(inner, values, rows, f"{column}_")
        elif about.rows and inner is not None:
            within = [_columns(inner, tuple(x), about.rows, f"{column}_") for x in values]
            for own in within[0] if within else ():
                dims, _, attributes = within[0][own]
                arrays = [np.asarray(x[own][1]) for x in within]
                found[own] = ((rows, *np.atleast_1d(dims)), _padded(arrays), attributes)
        elif about.is_in_arrays and any(x is not None for x in values):
            empty = np.empty((0,) * len(about.dims))
            arrays = [empty if x is None else np.asarray(_stored(x)) for x in values]
            found[column] = ((rows, *about.dims), _padded(arrays), _attributes(about))
            # How long each is along an axis on which they differ.
            for axis, dim in enumerate(about.dims):
                lengths = [x.shape[axis] for x in arrays]
                if dim in RAGGED or len(set(lengths)) > 1:
                    attributes = {"units": "1", "long_name": f"Length along {dim}"}
                    found[f"{prefix}n_{dim}"] = ((rows,), lengths, attributes)
        elif about.is_in_arrays:
            continue
        elif values and how == "" and all(isinstance(x, _COLUMNS) for x in values):
            plain: Any = [_stored(x) for x in values]
            if any(x is None for x in plain):
                plain = np.array([np.nan if x is None else x for x in plain])
            found[column] = (rows, plain, _attributes(about))
    return found


def _padded(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """The arrays stacked along a new first axis, shorter ones padded at their ends."""
    shape = np.max([x.shape for x in arrays], axis=0, initial=0).astype(int).tolist()
    return np.array([_lengthened(x, shape) for x in arrays])


def _dataset(variables: Mapping[str, Any], labels: Mapping[str, Sequence[str]]) -> xarray.Dataset:
    made = {
        name: (tuple(np.atleast_1d(dims).tolist()), np.asarray(values), attributes)
        for name, (dims, values, *more) in variables.items()
        for attributes in (more[0] if more else {},)
    }
    longest: dict[str, int] = {}
    for dims, values, _ in made.values():
        for dim, length in zip(dims, values.shape, strict=True):
            longest[dim] = max(length, longest.get(dim, 0))
    coords = {x: list(labels[x]) for x in longest if x in labels and x not in made}
    whole = {
        name: (dims, _lengthened(values, [longest[x] for x in dims]), attributes)
        for name, (dims, values, attributes) in made.items()
    }
    return xarray.Dataset(whole, coords=coords)


def _lengthened(values: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    if list(values.shape) == list(shape):
        return values
    filler: Any = {"f": np.nan, "i": -1, "U": ""}.get(values.dtype.kind, 0)
    whole = np.full(shape, filler, dtype=values.dtype)
    whole[tuple(slice(x) for x in values.shape)] = values
    return whole


def _attributes(about: Entry) -> dict[str, Any]:
    """Unit and meaning; what codes mean is said as the CF conventions have it."""
    said: dict[str, Any] = {"units": about.unit or "1", "long_name": about.meaning}
    if about.words:
        said["flag_values"] = list(range(len(about.words)))
        said["flag_meanings"] = " ".join(about.words)
    return said


def _stored(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def _filled(
    cls: type, plain: dict[str, Any], groups: Groups, group: str, prefix: str
) -> dict[str, Any]:
    filled = dict(plain)
    for name, about in entries(cls).items():
        own_group, key = about.group or group, about.key or name
        kind, how = record_within(type_hints_of(cls)[name])
        value, dataset = plain.get(key), groups.get(own_group)
        if how == "one" and (about.is_inline or not about.is_in_json):
            value = plain if about.is_inline else {}
        if kind is not None and about.rows and (value is not None or not about.is_in_json):
            variables = {} if dataset is None else dataset.variables
            arrays = {str(x): y.values for x, y in variables.items() if about.rows in y.dims}
            rows = value
            if not about.is_in_json:
                # Numbers and words that the groups alone have, one record for each row.
                n = max((len(x) for x in arrays.values()), default=0)
                own = [{key: x[row] for key, x in arrays.items()} for row in range(n)]
                rows = [_row_alone(kind, x, "") for x in own]
                if how != "list":
                    rows = dict(zip(map(str, arrays.get(about.rows, ())), rows, strict=True))
            filled[key] = _filled_rows(kind, rows, arrays, "")
        elif kind is not None and how == "one" and isinstance(value, dict):
            inner = _prefix_within(about, prefix, key)
            filled[key] = _filled(kind, value, groups, own_group, inner)
        elif not about.is_in_json and (found := _found(cls, name, groups, own_group, prefix)):
            filled[key] = found[0]
    return filled


def _found(cls: type, name: str, groups: Groups, group: str, prefix: str) -> list[Any]:
    """The values of a field in the groups, in a list; an empty one where they are not there."""
    about = entries(cls)[name]
    if about.dims and not about.is_in_arrays:
        places = [x for x in groups.values() if about.dims[0] in x.coords]
        return [[str(x) for x in places[0][about.dims[0]].values]] if places else []
    column = f"{prefix}{about.key or name}"
    dataset = groups.get(group)
    if dataset is None or column not in dataset:
        return []
    values = dataset[column].values
    return [values if about.dims else values.item()]


def _row_alone(kind: type, row: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for name, about in entries(kind).items():
        column = f"{prefix}{about.key or name}"
        inner, how = record_within(type_hints_of(kind)[name])
        if how == "one" and inner is not None:
            plain[about.key or name] = _row_alone(inner, row, f"{column}_")
        elif not about.dims and column in row:
            plain[about.key or name] = row[column].item()
    return plain


def _filled_rows(kind: type, records: Any, arrays: Mapping[str, np.ndarray], prefix: str) -> Any:
    rows = records.items() if isinstance(records, dict) else enumerate(records)
    filled = {
        name: _filled_row(kind, x, {key: y[row] for key, y in arrays.items() if y.ndim}, prefix)
        for row, (name, x) in enumerate(rows)
    }
    return filled if isinstance(records, dict) else list(filled.values())


def _filled_row(
    kind: type, plain: dict[str, Any], arrays: Mapping[str, Any], prefix: str
) -> dict[str, Any]:
    """One of several records, from its row of their arrays."""
    filled = dict(plain)
    for name, about in entries(kind).items():
        key = about.key or name
        column = f"{prefix}{key}"
        inner, how = record_within(type_hints_of(kind)[name])
        if how == "one" and inner is not None and isinstance(plain.get(key), dict):
            filled[key] = _filled_row(inner, plain[key], arrays, f"{column}_")
        elif about.rows and inner is not None:
            own = {x: y for x, y in arrays.items() if x.startswith(f"{column}_")}
            filled[key] = _filled_rows(inner, plain[key], own, f"{column}_")
        elif about.is_in_arrays and not about.is_in_json and column in arrays:
            lengths = [arrays.get(f"{prefix}n_{dim}") for dim in about.dims]
            cut = tuple(slice(None if x is None else int(x)) for x in lengths)
            values = np.asarray(arrays[column])[cut]
            # An array that a record may lack is NaN throughout where it does.
            may_miss = any(x.name == name and x.default is None for x in fields(kind))
            if not (may_miss and np.isnan(values).all()):
                filled[key] = values
    return filled


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
    try:
        values = with_arrays(cls, dict(summary), groups)
        answer: Given = from_plain(cls, values, file=file, remedy=AGAIN)
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
        tree.to_netcdf(temporary, engine="netcdf4")
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with xarray.open_datatree(path, engine="netcdf4") as tree:
                return {name: node.to_dataset().load() for name, node in tree.children.items()}
        # The libraries below raise errors of many types at a damaged file.
        except Exception as error:  # noqa: BLE001
            why = f"the arrays cannot be read ({type(error).__name__}: {shown(str(error))})"
    raise InputError(path, "", why, AGAIN)
