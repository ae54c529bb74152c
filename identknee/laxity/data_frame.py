"""Tables in memory: a pandas data frame as the text of the table that it would be saved as."""

import csv
import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from typing import Protocol as TypedProtocol

from typing_extensions import TypeIs

from identknee.runs.errors import InputError

# What messages call it, in place of a file.
NAME = "DataFrame"
# What `attrs` may state, each as a comment line of a file would.
STATED = ("zero", "within_trial_correlation", "translations", "levels", "angles")


class Frame(TypedProtocol):
    """What is used of a pandas ``DataFrame``; pandas itself is never imported."""

    attrs: dict[Any, Any]

    @property
    def columns(self) -> Any:
        """Names of the columns."""

    @property
    def index(self) -> Any:
        """Names of the rows."""

    def reset_index(self) -> "Frame":
        """The frame with its index as a column."""

    def to_csv(self, *, index: bool, quoting: int, header: bool = True) -> str:
        """Its text."""


def is_frame(value: object) -> TypeIs[Frame]:
    """Whether a value is a pandas data frame, or made like one."""
    return all(hasattr(value, x) for x in ("columns", "index", "reset_index", "to_csv"))


def frame_text(frame: Frame) -> tuple[str, tuple[str, ...]]:
    """The text of a table as CSV, and what to call each of its lines.

    Its ``attrs`` state what comment lines of a file do, as in ``frame.attrs["zero"] = "unloaded"``.
    A named index is a column, so that trials may be the index. A missing value is a blank.

    Raises
    ------
    InputError
        If columns have names of several levels, or trials stand in an index without a name.
    """
    if getattr(frame.columns, "nlevels", 1) > 1:
        why = "its columns have names of several levels"
        raise InputError(NAME, "columns", why, "Give each column one name, such as varus_deg.")
    if len(frame.columns) and str(frame.columns[0]).startswith("#"):
        # pandas took a comment line above the header for it, and all but that many cells for names.
        text = frame.to_csv(index=True, quoting=csv.QUOTE_NONNUMERIC, header=False)
        rows = (f"row {i}" for i in range(len(frame.index) - 1))
        return "\n".join([",".join(map(str, frame.columns)), text]), ("comment", "columns", *rows)
    named = any(x is not None for x in frame.index.names)
    labels = list(frame.index)
    are_words = bool(labels) and all(isinstance(x, str) for x in labels)
    if are_words and not named and "trial" not in frame.columns:
        remedy = 'If the index holds their names, call it so: frame.index.name = "trial".'
        raise InputError(NAME, "columns", "there is no column trial", remedy)
    attrs: Mapping[Any, Any] = getattr(frame, "attrs", {})
    keys = [x for x in attrs if isinstance(x, str) and statement_near(x, STATED)]
    stated = [f"# {x}: {_words(attrs[x])}" for x in keys]
    # Text is quoted, so that no name of a trial is taken for a comment.
    text = (frame.reset_index() if named else frame).to_csv(
        index=False, quoting=csv.QUOTE_NONNUMERIC
    )
    places = (
        *(f"attrs {x!r}" for x in keys),
        "columns",
        *(f"row {x}" for x in labels),
    )
    return "\n".join([*stated, text]), places


def statement_near(word: str, statements: Iterable[str]) -> str:
    """The statement that a word is or may be misspelled for; empty where there is none.

    Examples
    --------
    >>> statement_near("Translation", STATED), statement_near("translated", STATED)
    ('translations', '')
    """
    close = difflib.get_close_matches(word.casefold(), list(statements), n=1, cutoff=0.85)
    return close[0] if close else ""


def _words(value: Any) -> str:
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    return ", ".join(map(str, value)) if is_list else str(value)
