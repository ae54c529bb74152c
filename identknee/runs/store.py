"""Finished pieces of unfinished work, kept on disk so that the same command resumes."""

import json
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, digest, plain, prepare_folder

WAIT_S = 10.0
_ANEW = "Remove the file and start again, or choose another folder with --out."


class Store:
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
        # Of the runs before this one, that went as far as what is kept.
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        # Text that is damaged may be no UTF-8 any more.
        except UnicodeDecodeError as error:
            raise InputError(self.path, "", "its text is damaged", _ANEW) from error
        except sqlite3.Error as error:
            why, remedy = _explanation(error)
            raise InputError(self.path, "", why, remedy) from error


def _checksum(key: str, text: str) -> str:
    # A damaged text may hold half of a surrogate pair.
    return digest(f"{key} {text}".encode("utf-8", "surrogatepass"))


def _explanation(error: sqlite3.Error) -> tuple[str, str]:
    code = getattr(error, "sqlite_errorcode", None)
    primary = None if code is None else code & 0xFF
    if primary == sqlite3.SQLITE_FULL:
        return "the disk is full", "Free some space and give the same command again to resume."
    if primary in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
        return (
            "another run is writing to this file",
            "Wait for it to end, or choose another folder with --out.",
        )
    if primary in {sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT}:
        return (
            f"this is not a store of finished work, or it is damaged ({error})",
            _ANEW,
        )
    if primary in {sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM}:
        return (
            f"it may not be written to ({error})",
            "Choose another folder with --out, or change the permissions.",
        )
    return f"it cannot be used ({error})", "Remove the file and start again."
