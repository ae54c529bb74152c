"""Unfinished work kept in a file, so that the same command resumes where it stopped."""

import json
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from typing_extensions import override

from identknee.runs.errors import InputError
from identknee.runs.executors import Executor, WorkerTerminated, serial
from identknee.runs.files import FORBIDDEN, PathLike, digest, plain, prepare_folder
from identknee.runs.progress import progress_bar
from identknee.runs.record import versions

WAIT_S = 10.0
_ANEW = "Remove the file and start again, or choose another folder with --out."
_IN_USE = (
    "another run is writing to this file",
    "Wait for it to end, or choose another folder with --out.",
)
_DAMAGED = ("this is not a store of finished work, or it is damaged ({})", _ANEW)
# What went wrong, and the remedy, by SQLite's code.
_EXPLANATIONS = {
    sqlite3.SQLITE_FULL: (
        "the disk is full",
        "Free some space and give the same command again to resume.",
    ),
    sqlite3.SQLITE_BUSY: _IN_USE,
    sqlite3.SQLITE_LOCKED: _IN_USE,
    sqlite3.SQLITE_NOTADB: _DAMAGED,
    sqlite3.SQLITE_CORRUPT: _DAMAGED,
    sqlite3.SQLITE_READONLY: FORBIDDEN,
    sqlite3.SQLITE_CANTOPEN: FORBIDDEN,
    sqlite3.SQLITE_PERM: FORBIDDEN,
}


class Store(AbstractContextManager["Store"]):
    """A table from keys to JSON values in one SQLite file that outlives a crash.

    Each `put_many` is one transaction: after a kill or a power cut the file holds all of a batch or
    none of it. Numbers come back equal bit for bit, infinities and NaN too; arrays come back as
    lists. Each row has a checksum, so what comes back is what was put. One process writes; others
    may read meanwhile.

    Parameters
    ----------
    path
        The file, made with its folder where missing.

    Raises
    ------
    InputError
        If the file cannot be opened or written, or is not a store.
    """

    def __init__(self, path: PathLike) -> None:
        self.path = Path(path)
        # Time that earlier runs spent on the results kept here [s].
        self.earlier_s = 0.0
        self._began = time.perf_counter()
        prepare_folder(self.path.parent)
        with self._explained():
            self._connection = sqlite3.connect(self.path, timeout=WAIT_S)
        try:
            with self._explained():
                self._connection.execute("PRAGMA journal_mode=WAL")
                self._connection.execute("PRAGMA synchronous=FULL")
                with self._connection:
                    self._connection.execute(
                        "CREATE TABLE IF NOT EXISTS rows "
                        "(key TEXT PRIMARY KEY, value TEXT NOT NULL, checksum TEXT NOT NULL)"
                    )
        except InputError:
            self.close()
            raise

    @property
    def seconds(self) -> float:
        """Time spent on what is kept, by this run and those before it [s]."""
        return self.earlier_s + time.perf_counter() - self._began

    def get(self, key: str) -> Any:
        """Value under `key`, None where there is none.

        Raises
        ------
        InputError
            If the row is not what was put there.
        """
        with self._explained():
            row = self._connection.execute(
                "SELECT value, checksum FROM rows WHERE key = ?", (key,)
            ).fetchone()
        if row is None:
            return None
        value, checksum = row
        if not isinstance(value, str) or checksum != _checksum(key, value):
            raise InputError(self.path, f"row {key}", "it is damaged", _ANEW)
        return json.loads(value)

    def put_many(self, rows: Mapping[str, Any]) -> None:
        """Keep `rows`, all of them or none; a key already there gets the new value.

        Raises
        ------
        InputError
            If the disk is full or the file may not be written to.
        TypeError
            If a value has no JSON form.
        """
        texts = {key: json.dumps(plain(value, keep_nonfinite=True)) for key, value in rows.items()}
        kept = [(key, text, _checksum(key, text)) for key, text in texts.items()]
        with self._explained(), self._connection:
            self._connection.executemany("INSERT OR REPLACE INTO rows VALUES (?, ?, ?)", kept)

    def keys(self) -> set[str]:
        """All keys kept so far."""
        with self._explained():
            found = {key for (key,) in self._connection.execute("SELECT key FROM rows")}
        if not all(isinstance(key, str) for key in found):
            raise InputError(self.path, "", "the names of its rows are damaged", _ANEW)
        return found

    def clear(self) -> None:
        """Forget all keys."""
        with self._explained(), self._connection:
            self._connection.execute("DELETE FROM rows")

    def close(self) -> None:
        """Close the file; what was put is on disk already."""
        self._connection.close()

    @override
    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        # Text that is damaged may be no UTF-8 any more.
        except UnicodeDecodeError as error:
            raise InputError(self.path, "", "its text is damaged", _ANEW) from error
        except sqlite3.Error as error:
            code = getattr(error, "sqlite_errorcode", None)
            why, remedy = _EXPLANATIONS.get(
                -1 if code is None else code & 0xFF,
                ("it cannot be used ({})", "Remove the file and start again."),
            )
            raise InputError(self.path, "", why.format(error), remedy) from error


def _checksum(key: str, text: str) -> str:
    # A damaged text may hold half of a surrogate pair.
    return digest(f"{key} {text}".encode("utf-8", "surrogatepass"))


STORE_FORMAT = 1
HEADER = "about"
FINISHED, SPENT = "finished", "seconds"
# Time between commits. Each waits for the disk, and a kill loses what was finished since the last.
COMMIT_S = 1.0
# Items given to the executor at a time, so that a million items are not a million tasks in memory.
WAVE = 2000
_REMEDY = (
    "Give the inputs and settings of the first run again to resume it, or remove the file or "
    "choose another folder with --out to start anew."
)


def open_work(path: PathLike, about: Mapping[str, Any]) -> Store:
    """Store of unfinished work, new or left by an earlier run with the same inputs and settings.

    A store of finished work (`finish_work`) with other inputs or settings is emptied.

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
        "about": json_round_trip(about),
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
        `open_work` must have been given what that list follows from.
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
    WorkerTerminated
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
    waiting, task = [items[index] for index in missing], partial(_plain_result, function)
    waves = (waiting[first : first + WAVE] for first in range(0, len(waiting), WAVE))
    fresh = (result for wave in waves for result in executor.map(task, wave))
    bar = progress_bar(description, len(items), before=len(results))
    with bar as advance, _Commits(store) as commits:
        if results and missing:
            advance.say(f"{description}: resumed at {len(results):,} of {len(items):,}")
        for index, result in zip(missing, _explained(fresh, store), strict=True):
            results[keys[index]] = result
            commits.add(keys[index], result)
            advance(1)
    return [results[key] for key in keys]


def json_round_trip(value: Any) -> Any:
    """`value` as it would be read back from a store.

    Raises
    ------
    TypeError
        If it has no JSON form.

    Examples
    --------
    >>> json_round_trip({"theta": (1.5, float("inf"))})
    {'theta': [1.5, inf]}
    """
    return json.loads(json.dumps(plain(value, keep_nonfinite=True)))


class _Commits(AbstractContextManager["_Commits"]):
    """Puts results into a store about once a second, and the rest on leaving, come what may."""

    def __init__(self, store: Store | None) -> None:
        self._store = store
        self._waiting: dict[str, Any] = {}
        self._last = time.monotonic()

    @override
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


def _plain_result(function: Callable[[Any], Any], item: Any) -> Any:
    return json_round_trip(function(item))


def _explained(results: Iterable[Any], store: Store | None) -> Iterator[Any]:
    try:
        yield from results
    except WorkerTerminated as error:
        if store is None:
            raise
        raise WorkerTerminated(
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
    """A phrase for each value that differs."""
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
