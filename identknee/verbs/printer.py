"""The printer of answers: the report, which verbs may not import, registers it here."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


class Printer(Protocol):
    """Shows answers as text, tables and figures."""

    def terminal_lines(self, answer: Any) -> list[str]:
        """All that the answer says."""

    def brief_lines(self, answer: Any) -> list[str]:
        """What a command prints of the answer."""

    def short_text(self, answer: Any) -> str:
        """What fits on a screen."""

    def html(self, answer: Any) -> str:
        """What a notebook shows."""

    def figure(self, answer: Any, name: str | None, **where: Any) -> "Figure":
        """A figure of that name, or the most informative one."""

    def dataframe(self, answer: Any, table: str | None) -> "DataFrame":
        """A table of that name, or the first one."""

    def methods(self, answer: Any) -> str:
        """How the answer was computed, for a paper."""


_given: list[Callable[[], Printer]] = []


def set_printer(load: Callable[[], Printer]) -> None:
    """Register `load`, which returns the printer; it is called whenever an answer is shown."""
    _given[:] = [load]


def printer() -> Printer | None:
    """The registered printer; None before `set_printer`."""
    return _given[0]() if _given else None
