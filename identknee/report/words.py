"""Lists and intervals in words."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from identknee.laxity.trial_words import trial_description
from identknee.runs.words import capitalised, interval, listed


def trial_list(trials: Iterable[Mapping[str, Any]]) -> str:
    """Trials to do, the beginning of a sentence."""
    return capitalised(counted(map(trial_description, trials)))


def counted(told: Iterable[str]) -> str:
    """A list in which what comes more than once stands once, with how often.

    Examples
    --------
    >>> counted(["a", "b", "a"])
    'a (twice) and b'
    """
    counts = Counter(told)
    return listed(x if n == 1 else f"{x} ({times(n)})" for x, n in counts.items())


def times(n: int) -> str:
    """How often, in words.

    Examples
    --------
    >>> times(1), times(2), times(3)
    ('once', 'twice', '3 times')
    """
    return {1: "once", 2: "twice"}.get(n, f"{n} times")


def interval_words(lower: float | None, upper: float | None, unit: str) -> str:
    """An interval as what a quantity is, open ends included.

    Examples
    --------
    >>> interval_words(9.5, 10.5, "kN"), interval_words(None, None, "kN")
    ('9.5 to 10.5 kN', 'open on both sides')
    """
    if lower is None and upper is None:
        return "open on both sides"
    return interval((lower, upper), unit)
