"""Errors that users see: files and values that cannot be used, and answers that do not exist."""

import difflib
import os
from collections.abc import Iterable

from typing_extensions import override


class InputError(ValueError):
    """A file or folder that cannot be used, as one sentence and its remedy.

    The message reads "PATH, WHERE: WHY. REMEDY".

    Parameters
    ----------
    path
        The file or folder.
    where
        The place in it, such as ``"row 7, column varus_deg"``; empty for the whole file.
    why
        What is wrong, without the full stop.
    remedy
        What to do about it, a sentence of its own.

    Examples
    --------
    >>> print(InputError("a.csv", "row 7", "the trial has no name", "Name it."))
    a.csv, row 7: the trial has no name. Name it.
    """

    def __init__(self, path: str | os.PathLike[str], where: str, why: str, remedy: str) -> None:
        # All four go to the base class so that the error survives the trip from a worker process.
        super().__init__(os.fspath(path), where, why, remedy)
        self.path = os.fspath(path)
        self.where = where
        self.why = why
        self.remedy = remedy

    @override
    def __str__(self) -> str:
        """The whole message."""
        place = f"{self.path}, {self.where}" if self.where else self.path
        sentence = f"{place}: {self.why.rstrip('.')}."
        whole = f"{sentence} {self.remedy}" if self.remedy else sentence
        # Names and values from a file may hold anything, line breaks too.
        return "".join(x if x.isprintable() else "?" for x in whole)


class ValueRefused(ValueError):  # noqa: N818 - said to a person as a sentence
    """Raised where a value cannot be used: what is wrong, and what to do about it.

    Examples
    --------
    >>> print(ValueRefused("two ligaments are called ACL", "rename one of them"))
    two ligaments are called ACL; rename one of them
    """

    def __init__(self, why: str, remedy: str) -> None:
        super().__init__(why, remedy)
        self.why, self.remedy = why, remedy

    @override
    def __str__(self) -> str:
        """Both, as one sentence."""
        return f"{self.why}; {self.remedy}"

    @property
    def advice(self) -> str:
        """What to do, as a sentence of its own."""
        return f"{self.remedy[:1].upper()}{self.remedy[1:]}."


def suggestion(word: str, known: Iterable[str], *, most: int | None = None) -> str:
    """Sentence that names the closest of the `known` words, or the first `most` if none is close.

    Examples
    --------
    >>> suggestion("varus", ["varus_deg", "internal_deg"])
    'Did you mean varus_deg?'
    >>> suggestion("speed", ["varus_deg", "internal_deg"])
    'Known names: varus_deg, internal_deg.'
    """
    names = list(known)
    if close := closest(word, names):
        return f"Did you mean {close}?"
    shown = names[:most]
    more = f" and {len(names) - len(shown)} more" if len(shown) < len(names) else ""
    return f"Known names: {', '.join(shown)}{more}."


def closest(word: str, known: Iterable[str]) -> str:
    """The closest of the `known` words; empty where none is close.

    Examples
    --------
    >>> closest("varus", ["varus_deg", "internal_deg"]), closest("speed", ["varus_deg"])
    ('varus_deg', '')
    """
    names = {name.casefold(): name for name in known}
    close = difflib.get_close_matches(word.casefold(), list(names), n=1, cutoff=0.55)
    close = close or [name for name in names if name.startswith(word.casefold())]
    return names[close[0]] if close else ""


class NotComputable(Exception):  # noqa: N818 - said to a person as a sentence
    """Raised where the input is valid and the answer cannot be computed; the message says why."""
