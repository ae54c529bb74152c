"""The verbs that fit, each with options with which it answers in seconds where little is free."""

from collections.abc import Callable, Collection, Mapping
from typing import Any

from held import both_of
from slow_cases import some_slow

import identknee as ik
from identknee.verbs.answer import Answer

QUICK: Mapping[str, tuple[Callable[..., Answer], Mapping[str, Any]]] = {
    "fit": (ik.fit, {"more_starts": 0, "weighting": "noise"}),
    "profile": (ik.profile, {"parameters": ["ACL.stiffness_kN"]}),
    "information": (ik.information, {}),
    "sweep": (ik.sweep, {"n_starts": 4, "paths": 0}),
    "equivalents": (ik.equivalents, {"n_sets": 4, "forces": "none"}),
    "design": (ik.design, {"n_trials": 1, "candidates": "drawer", "criterion": "c"}),
    "sample": (ik.sample, {"moves": "difference", "budget": 700}),
}
# Parameters without which two stay free.
ALL_BUT_ACL = both_of("PCL", "LCL", "MCL")
# Parameters without which four stay free.
ALL_BUT_FOUR = [*(f"{x}.stiffness_kN" for x in ("PCL", "LCL", "MCL")), "LCL.reference_strain_pct"]


def quick_verbs(names: Collection[str] = tuple(QUICK), *, slow: Collection[str]) -> list[Any]:
    """The names of these verbs as cases of a test, the slow ones marked as such."""
    return some_slow(names, slow)


def quick(verb: str, *data: Any, **asked: Any) -> Any:
    """The answer of a verb to knee and laxity, with its quick options and those asked for."""
    function, options = QUICK[verb]
    return function(*data, **{**options, **asked})
