"""Maps that survive a kill: finished results wait in a store, and the same command goes on."""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from identknee.runs.errors import InputError
from identknee.runs.executors import Executor, WorkerDied, serial
from identknee.runs.files import PathLike, plain
from identknee.runs.progress import progress_bar
from identknee.runs.record import versions
from identknee.runs.store import Store

STORE_FORMAT = 1
HEADER = "about"
FINISHED, SPENT = "finished", "seconds"
# A kill loses what was finished in this time, and each commit waits for the disk.
COMMIT_S = 1.0
# Handed to the executor at a time, so that a million items are not a million tasks in memory.
WAVE = 2000
_REMEDY = (
    "Give the inputs and settings of the first run again to resume it, or remove the file or "
    "choose another folder with --out to start anew."
)


def open_work(path: PathLike, about: Mapping[str, Any]) -> Store:
    """Store of unfinished work, new or left by an earlier run about the same.

    What a run left that was finished (`finish_work`) is replaced where it is about something else.

    Parameters
    ----------
    path
        The file, made with its folder where missing.
    about
        All that the results depend on: the digests of the inputs, every setting, the seed; in JSON
        types, mappings within it welcome. The number of workers is not part of it.

    Raises
    ------
    InputError
        If the file cannot be used, is of another format or version of identknee, or is about
        something else; it says which input or setting changed.
    TypeError
        If `about` holds a value without JSON form.
    """
    header = {
        "format": STORE_FORMAT,
        "identknee": versions().get("identknee", "unknown"),
        "about": as_stored(about),
    }
    store = Store(path)
    try:
        kept = store.get(HEADER)
        is_finished = isinstance(kept, dict) and kept.get(FINISHED, False)
        if kept is None and not store.keys():
            store.put_many({HEADER: header})
        elif not is_finished:
            _check_header(store, kept, header)
        elif kept != {**header, FINISHED: True}:
            store.clear()
            store.put_many({HEADER: header})
        store.earlier_s = float(store.get(SPENT) or 0.0)
    except BaseException:
        store.close()
        raise
    return store


def finish_work(path: PathLike) -> None:
    """Note in the store at `path` that its results are written elsewhere and may be replaced.

    Raises
    ------
    InputError
        If the store cannot be written.
    """
    with Store(path) as store:
        store.put_many({HEADER: {**store.get(HEADER), FINISHED: True}})


def resumable_map(
    function: Callable[[Any], Any],
    items: Sequence[Any],
    *,
    executor: Executor = serial,
    store: Store | None = None,
    name: str = "",
    description: str = "computing",
) -> list[Any]:
    """Results of `function` for each of `items`, in their order, as plain JSON values.

    Arrays come back as lists, infinities and NaN as themselves. The results are the same bit for
    bit with any executor, with a store or without, and after any number of interruptions.

    Parameters
    ----------
    function
        From the top of a module, or a `functools.partial` of one, if `executor` runs processes.
    items
        What to go through. Results are kept by position: a store is for one list of items, and
        `open_work` must have been told what that list follows from.
    executor
        Anything with an ordered ``map``.
    store
        Where finished results are kept and looked for; from `open_work`.
    name
        Which map this is, where one store serves several.
    description
        What the progress bar says.

    Raises
    ------
    WorkerDied
        If a worker process ends before its task; what was finished is kept.
    InputError
        If the store cannot be written, as on a full disk; what it holds is not harmed.
    TypeError
        If a result has no JSON form.
    """
    keys = [f"{name}/{index}" for index in range(len(items))]
    done = set() if store is None else store.keys()
    results = {key: store.get(key) for key in keys if store is not None and key in done}
    missing = [index for index, key in enumerate(keys) if key not in results]
    fresh = _computed(function, [items[index] for index in missing], executor)
    bar = progress_bar(description, len(items), before=len(results))
    with bar as advance, _Commits(store) as commits:
        for index, result in zip(missing, _explained(fresh, store), strict=True):
            results[keys[index]] = result
            commits.add(keys[index], result)
            advance(1)
    return [results[key] for key in keys]


def as_stored(value: Any) -> Any:
    """`value` as it would be read back from a store.

    Raises
    ------
    TypeError
        If it has no JSON form.

    Examples
    --------
    >>> as_stored({"theta": (1.5, float("inf"))})
    {'theta': [1.5, inf]}
    """
    return json.loads(json.dumps(plain(value, keep_nonfinite=True)))


class _Commits:
    """Puts results into a store about once a second, and the rest on leaving, come what may."""

    def __init__(self, store: Store | None) -> None:
        self._store = store
        self._waiting: dict[str, Any] = {}
        self._last = time.monotonic()

    def __enter__(self) -> "_Commits":
        return self

    def __exit__(self, *_: object) -> None:
        self._commit()

    def add(self, key: str, result: Any) -> None:
        self._waiting[key] = result
        if time.monotonic() - self._last > COMMIT_S:
            self._commit()

    def _commit(self) -> None:
        if self._store is not None and self._waiting:
            self._store.put_many({**self._waiting, SPENT: self._store.seconds})
        self._waiting = {}
        self._last = time.monotonic()


def _computed(
    function: Callable[[Any], Any], items: Sequence[Any], executor: Executor
) -> Iterator[Any]:
    for first in range(0, len(items), WAVE):
        yield from executor.map(partial(_plain_result, function), items[first : first + WAVE])


def _plain_result(function: Callable[[Any], Any], item: Any) -> Any:
    return as_stored(function(item))


def _explained(results: Iterable[Any], store: Store | None) -> Iterator[Any]:
    try:
        yield from results
    except WorkerDied as error:
        if store is None:
            raise
        raise WorkerDied(
            f"{error}. What was finished is kept in {store.path}: the same command again resumes"
        ) from error


def _check_header(store: Store, kept: Any, header: Mapping[str, Any]) -> None:
    if not isinstance(kept, dict) or kept.get("format") != header["format"]:
        found = kept.get("format") if isinstance(kept, dict) else None
        raise InputError(
            store.path,
            "",
            f"it holds unfinished work in format {found}, this version of identknee writes "
            f"format {header['format']}",
            "Remove the file or choose another folder with --out to start anew.",
        )
    if kept["identknee"] != header["identknee"]:
        raise InputError(
            store.path,
            "",
            f"it holds unfinished work of identknee {kept['identknee']}, this is identknee "
            f"{header['identknee']}, whose numbers may differ",
            "Finish it with that version, or remove the file or choose another folder with --out "
            "to start anew.",
        )
    changes = list(_changes(kept["about"], header["about"]))
    if changes:
        why = f"it holds unfinished work that differs from what is asked: {'; '.join(changes)}"
        raise InputError(store.path, "", why, _REMEDY)


def _changes(before: Any, now: Any, place: str = "") -> Iterator[str]:
    """What differs, one phrase a value."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in [*before, *(key for key in now if key not in before)]:
            inner = f"{place}.{key}" if place else key
            if key not in now:
                yield f"{inner} was {_shown(before[key])} and is not given now"
            elif key not in before:
                yield f"{inner} was not given and is {_shown(now[key])} now"
            else:
                yield from _changes(before[key], now[key], inner)
    # As text, because NaN differs from itself.
    elif json.dumps(before) != json.dumps(now):
        if _is_digest(before) and _is_digest(now):
            yield f"the content of {place} has changed"
        else:
            yield f"{place} was {_shown(before)} and is {_shown(now)} now"


def _is_digest(value: Any) -> bool:
    return isinstance(value, str) and len(value) == 64 and set(value) <= set("0123456789abcdef")


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
