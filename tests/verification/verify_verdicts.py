"""What `diagnose` concludes: torn ligaments, one cause, two, and causes that no library lists.

    python tests/verification/run_verification.py --only two_causes [--workers N]

Each of `ROWS` is a row. Every case is drawn by its seed. What is finished is kept line by line in
the folder of temporary files, so that the same command resumes.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import product
from typing import Any

from blind_diagnoses import BlindTask, outcome_of
from kept_outcomes import KeptOutcomes
from knees import knee
from requirement_rows import Row
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
# After so many cases the row is written anew.
CHUNK = 12
Made = Callable[[], dict[str, Any]]


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row of what is kept from earlier runs, then with every `CHUNK` cases more."""
    tasks = {f"{name}:{i}": x for name in ROWS[options.row] for i, x in enumerate(PARTS[name]())}
    keys = [x for x in tasks if x not in KEPT.known()]
    if len(keys) < len(tasks):
        yield row_of(options.row, KEPT.known())
    for start in range(0, len(keys), CHUNK):
        KEPT.compute({x: tasks[x] for x in keys[start : start + CHUNK]}, options.workers)
        yield row_of(options.row, KEPT.known())


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
    return [(x, signal, 176_000 + i) for i, (_, signal, x) in cases]


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
# The parts of each row.
ROWS: Mapping[str, tuple[str, ...]] = {
    "torn": ("torn",),
    "constant_causes": ("constant", "constant2"),
    "two_causes": ("pairs",),
    "unlisted_causes": ("distances", "unlisted"),
    "one_cause": ("singles", "real", "nulls"),
}
LINES: Mapping[str, str] = {
    "torn": "a ligament that carries nothing, 2 knees: ADEQUATE, and the ligament named, >= 95 %",
    "constant_causes": "weight, compression or muscles hidden: answered with more causes <= 3 %",
    "two_causes": "two causes hidden: both named, or in the group, >= 70 %",
    "unlisted_causes": "causes that no library lists, >= 5 units from all listed: NAMED <= 10 %",
    "one_cause": "one cause hidden, of all kinds: answered with more <= 3 %, false alarms <= 8 %",
}


def row_of(row: str, known: Mapping[str, dict[str, Any]]) -> Row:
    """One of `ROWS` from the outcomes known so far."""
    found: dict[str, Outcomes] = {name: [] for name in ROWS[row]}
    for key, outcome in known.items():
        name = key.partition(":")[0]
        if name in found and "error" not in outcome:
            found[name].append(outcome)
    every = [x for own in found.values() for x in own]
    hidden = [x for name, own in found.items() if name != "nulls" for x in own]
    shares: list[tuple[str, Outcomes, Callable[[dict[str, Any]], bool], float | None, bool]]
    if row == "torn":
        shares = [("adequate, and the ligament named", every, _is_torn, 0.95, True)]
    elif row == "two_causes":
        shares = [
            ("both named or in the group", every, _has_both, 0.7, True),
            ("exactly both named", every, _is_exact, None, True),
            ("more than two causes named", every, _is_many, 0.0, False),
        ]
    elif row == "unlisted_causes":
        far = {x["seed"] for x in found["distances"] if x["distance"] >= LEAST_DISTANCE}
        unlisted = [x for x in found["unlisted"] if x["seed"] in far]
        shares = [("named", unlisted, _is_named, 0.1, False)]
    else:
        shares = [
            ("answered with more", hidden, _has_more, 0.03, False),
            ("more than two causes named", hidden, _is_many, 0.0, False),
            ("wrong name", hidden, _is_wrong, 0.03, False),
            ("truth named or in the group", hidden, _is_in_group, None, True),
            ("right name", hidden, _is_right, None, True),
            ("false alarms", found.get("nulls", []), is_alarm, 0.08, False),
        ]
    notes = [
        *(f"{name}: {len(own)} of {len(PARTS[name]())} cases" for name, own in found.items()),
        *(verdicts_of(name, own) for name, own in found.items() if own and "verdict" in own[0]),
        *(told(x) for x in hidden if x.get("wrong")),
        *(
            f"not adequate or not named: {x['ligament']} {x['kind']}, {x['verdict']}, "
            f"seed {x['seed']}"
            for x in found.get("torn", [])
            if not _is_torn(x)
        ),
    ]
    return Row(
        line=LINES[row],
        measures=[
            share_of(what, own, holds, bar=bar, at_least=at_least)
            for what, own, holds, bar, at_least in shares
            if own
        ],
        notes=notes,
    )


def _is_torn(x: Mapping[str, Any]) -> bool:
    return bool(x["verdict"] == "ADEQUATE" and x["named"])


def _is_wrong(x: Mapping[str, Any]) -> bool:
    return bool(x["wrong"])


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
