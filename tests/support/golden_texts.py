"""Texts that are kept word by word: what is said where no number can be asserted instead."""

from collections.abc import Callable
from pathlib import Path

GOLDEN = Path(__file__).parents[1] / "golden"
# What the fixture `golden` is: a function of the name of a text and the text.
Golden = Callable[[str, str], None]


def kept_text(name: str, text: str = "") -> str:
    """The text kept under this name, such as ``"help/identknee-fit"``; a text given replaces it."""
    path = GOLDEN / f"{name}.txt"
    if text:
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"{text}\n", encoding="utf-8")
    return path.read_text(encoding="utf-8")
