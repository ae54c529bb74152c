"""What `diagnose` concludes: torn ligaments, one cause, two, and causes that no library lists.

    python tests/verification/run_verification.py --only verdicts [--workers N]

Every case is drawn by its seed. What is finished is kept line by line in the folder of temporary
files, so that the same command resumes; the row is written after every part.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import product
from typing import Any

from blind_diagnoses import BlindTask, outcome_of
from kept_outcomes import KeptOutcomes
from knees import knee
from requirement_rows import Measure, Row
from verdict_cases import distance_from_listed, torn_outcome
from verify_blind import (
    LISTED_BEFORE,
    PAIRS,
    REAL,
    REFERENCE,
    Outcomes,
    is_alarm,
    share_of,
    told,
    verdicts_of,
)

from identknee.blind.case import blind_case

KEPT = KeptOutcomes("verdicts")
CONSTANT = ("shank_gravity", "compression", "muscle_tension")
UNLISTED = (
    "missing_line",
    "broad_strap",
    "two_point_tether",
    "rotational_spring",
    "constant_pull",
    "one_way_yield",
)
LEAST_DISTANCE = 5.0
Made = Callable[[], dict[str, Any]]


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row of what is kept from earlier runs, then with every part more."""
    if known := KEPT.known():
        yield row_of(_of_parts(known))
    for name, made in PARTS.items():
        KEPT.compute({f"{name}:{i}": x for i, x in enumerate(made())}, options.workers)
        yield row_of(_of_parts(KEPT.known()))


def _of_parts(known: Mapping[str, dict[str, Any]]) -> dict[str, Outcomes]:
    found: dict[str, Outcomes] = {name: [] for name in PARTS}
    for key, outcome in known.items():
        found[key.partition(":")[0]].append(outcome)
    return found


def _blind(
    effects: tuple[str, ...], signal: float | None, seed: int, subject: str = REFERENCE
) -> Made:
    task = BlindTask(
        subject=subject, effects=effects, signal=signal, seed=seed, measures_gain=False
    )
    return partial(outcome_of, task)


def _pairs() -> list[Made]:
    cases = product(range(10), PAIRS)
    return [_blind(pair, 12.0, 140_000 + i) for i, (_, pair) in enumerate(cases)]


def _singles() -> list[Made]:
    cases = enumerate(product(range(3), (4.0, 6.0, 10.0, 20.0), LISTED_BEFORE))
    return [_blind((x,), signal, 120_000 + i) for i, (_, signal, x) in cases if signal >= 10.0]


def _real() -> list[Made]:
    cases = enumerate(product((10.0, 20.0), LISTED_BEFORE))
    return [_blind((x,), signal, 130_000 + i, REAL) for i, (signal, x) in cases]


def _constant() -> list[Made]:
    cases = enumerate(product(range(10), (8.0, 15.0), CONSTANT))
    return [_blind((x,), signal, 160_000 + i) for i, (_, signal, x) in cases]


def _constant_of_the_literature() -> list[Made]:
    cases = enumerate(product(range(10), (REFERENCE, REAL), CONSTANT))
    return [_blind((x,), None, 165_000 + i, subject) for i, (_, subject, x) in cases]


def _torn() -> list[Made]:
    cases = enumerate(product(range(40), (REFERENCE, REAL)))
    return [partial(torn_outcome, subject, 180_000 + i) for i, (_, subject) in cases]


def _nulls() -> list[Made]:
    return [_blind((), None, 100_000 + i) for i in range(200)]


def _unlisted_cases() -> list[tuple[str, float, int]]:
    cases = enumerate(product(range(10), (12.0, 20.0), UNLISTED))
    return [(x, signal, 170_000 + i) for i, (_, signal, x) in cases]


def _unlisted() -> list[Made]:
    return [_blind((x,), signal, seed) for x, signal, seed in _unlisted_cases()]


def distance_of(effect: str, signal: float, seed: int) -> dict[str, Any]:
    """How far an unlisted cause is from all that are listed."""
    about = {"effects": [effect], "seed": seed}
    try:
        case = blind_case(knee(REFERENCE), seed=seed, effect=[effect], signal=signal)
    except ValueError as error:
        return {**about, "error": str(error)}
    distance, nearest = distance_from_listed(REFERENCE, case)
    return {**about, "distance": distance, "nearest": nearest}


def _distances() -> list[Made]:
    return [partial(distance_of, *x) for x in _unlisted_cases()]


# In this order, so that a run cut short tells of what is new.
PARTS: Mapping[str, Callable[[], list[Made]]] = {
    "torn": _torn,
    "constant": _constant,
    "constant2": _constant_of_the_literature,
    "pairs": _pairs,
    "unlisted": _unlisted,
    "distances": _distances,
    "singles": _singles,
    "real": _real,
    "nulls": _nulls,
}


def row_of(found: Mapping[str, Outcomes]) -> Row:
    """The row of what was found of each part; parts without outcomes are left out."""
    known = {name: [x for x in own if "error" not in x] for name, own in found.items()}
    singles = [*known["singles"], *known["real"]]
    constant = [*known["constant"], *known["constant2"]]
    far = {x["seed"] for x in known["distances"] if x["distance"] >= LEAST_DISTANCE}
    unlisted = [x for x in known["unlisted"] if x["seed"] in far]
    shares = [
        (
            "torn or slack ligament: adequate, and the ligament named",
            known["torn"],
            lambda x: x["verdict"] == "ADEQUATE" and x["named"],
            0.95,
            True,
        ),
        ("one cause, all kinds: answered with more", singles, _has_more, 0.03, False),
        ("weight, compression, muscles: answered with more", constant, _has_more, 0.03, False),
        ("two causes: both named or in the group", known["pairs"], _has_both, 0.7, True),
        ("two causes: exactly both named", known["pairs"], _is_exact, None, True),
        ("no listed cause: named all the same", unlisted, _is_named, 0.1, False),
        (
            "more than two causes named",
            [*singles, *constant, *known["pairs"]],
            _is_many,
            0.0,
            False,
        ),
        ("one cause: wrong name", [*singles, *constant], lambda x: bool(x["wrong"]), 0.03, False),
        ("one cause: truth named or in the group", singles, _is_in_group, None, True),
        ("one cause: right name", singles, _is_right, None, True),
        ("false alarms", known["nulls"], is_alarm, 0.08, False),
    ]
    measures: list[Measure] = [
        share_of(what, own, holds, bar=bar, at_least=at_least)
        for what, own, holds, bar, at_least in shares
        if own
    ]
    notes = [
        *(f"{name}: {len(own)} of {len(PARTS[name]())} cases" for name, own in found.items()),
        *(verdicts_of(name, own) for name, own in known.items() if own and name != "distances"),
        *(told(x) for x in [*singles, *constant, *known["pairs"]] if x.get("wrong")),
        *(
            f"not adequate or not named: {x['ligament']} {x['kind']}, {x['verdict']}, "
            f"seed {x['seed']}"
            for x in known["torn"]
            if x["verdict"] != "ADEQUATE" or not x["named"]
        ),
    ]
    return Row(
        line="conclusions: torn ligaments, one cause, two, none listed",
        measures=measures,
        notes=notes,
    )


def _has_more(x: Mapping[str, Any]) -> bool:
    return len(x["causes"]) > len(x["effects"])


def _has_both(x: Mapping[str, Any]) -> bool:
    return set(x["effects"]) <= set(x["group"]) | set(x["causes"])


def _is_exact(x: Mapping[str, Any]) -> bool:
    return bool(x["verdict"] == "NAMED" and set(x["effects"]) == set(x["causes"]))


def _is_named(x: Mapping[str, Any]) -> bool:
    return bool(x["verdict"] == "NAMED")


def _is_many(x: Mapping[str, Any]) -> bool:
    return bool(x["verdict"] == "NAMED" and len(x["causes"]) > 2)


def _is_in_group(x: Mapping[str, Any]) -> bool:
    return bool(x["in_group"])


def _is_right(x: Mapping[str, Any]) -> bool:
    return bool(x["verdict"] == "NAMED" and x["correct"])
