"""Trials in words that need no manual."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from identknee.laxity.protocol import FLEXION, LOADS
from identknee.runs.words import UNITS, interval, listed

OPPOSITES = {
    "internal_moment_Nm": "external moment",
    "varus_moment_Nm": "valgus moment",
    "anterior_force_N": "posterior force",
    "distraction_force_N": "compression",
    "lateral_force_N": "medial force",
}


def trial_words(trial: Mapping[str, Any]) -> str:
    """A trial to do, from its angle and loads.

    Examples
    --------
    >>> trial_words({"flexion_deg": 30.0, "anterior_force_N": -134.0})
    'posterior force of 134 N at 30 deg of flexion'
    """
    loads = [
        f"{_load_name(name, float(trial[name]))} of {abs(float(trial[name])):g} "
        f"{UNITS.get(name.rpartition('_')[2], name.rpartition('_')[2])}"
        for name in LOADS
        if float(trial.get(name) or 0.0) != 0.0
    ]
    return f"{listed(loads) or 'no load'} at {float(trial[FLEXION]):g} deg of flexion"


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


def _load_name(name: str, value: float) -> str:
    return OPPOSITES[name] if value < 0 else name.rpartition("_")[0].replace("_", " ")
