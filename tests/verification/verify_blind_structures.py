"""Blind cases of menisci, wrapping and capsule, hidden by the mechanics of the separate generator.

    python tests/verification/run_verification.py --only blind_structures [--workers N]

A case is isolable where its data without errors lie 5 units of noise or more from every other cause
of the library. Both knees have four lines: in a knee of 55 bundles most draws leave a trial without
equilibrium. What is finished is kept, so that the same command resumes.
"""

import argparse
from collections.abc import Iterator
from functools import partial
from itertools import product
from typing import Any

from blind_diagnoses import BlindTask, outcome_of
from kept_outcomes import KeptOutcomes
from knees import knee
from requirement_rows import Measure, Row
from verdict_cases import distance_from_listed
from verify_blind import REAL, REFERENCE, is_in_group, is_right, is_wrong, share_of, told

from identknee.blind.case import blind_case
from identknee.diagnosis.score import LEAST_DISTANCE

KNEES = (REFERENCE, REAL)
HIDDEN = ("meniscal_wedge", "mcl_wrapping", "posterior_capsule")
SIGNALS, N = (12.0, 20.0), 10
FIRST_SEED = 190_000
CHUNK = 12
KEPT = KeptOutcomes("blind_structures")


def structure_outcome(task: BlindTask) -> dict[str, Any]:
    """What came of a case, and how far it is from what else the library lists."""
    found = outcome_of(task)
    if "error" in found:
        return found
    (hidden,) = task.effects
    case = blind_case(knee(task.subject), seed=task.seed, effect=[hidden], signal=task.signal)
    distance, nearest = distance_from_listed(task.subject, case, without=hidden)
    return {**found, "distance": distance, "nearest_listed": nearest}


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row of what is kept from earlier runs, then with `CHUNK` cases more each time."""
    cases = enumerate(product(range(N), KNEES, SIGNALS, HIDDEN))
    tasks = {
        f"{subject} {i}": BlindTask(
            subject=subject,
            effects=(effect,),
            signal=signal,
            seed=FIRST_SEED + i,
            measures_gain=False,
        )
        for i, (_, subject, signal, effect) in cases
    }
    keys = [x for x in tasks if x not in KEPT.known()]
    for start in range(0, len(keys), CHUNK):
        KEPT.compute(
            {x: partial(structure_outcome, tasks[x]) for x in keys[start : start + CHUNK]},
            options.workers,
        )
        yield _row(KEPT.known(), len(tasks))
    if not keys:
        yield _row(KEPT.known(), len(tasks))


def _is_only_name(outcome: dict[str, Any]) -> bool:
    return bool(outcome["group"] == outcome["effects"])


def _row(known: dict[str, dict[str, Any]], n: int) -> Row:
    found = [
        {**x, "knee": key.split()[0], "is_isolable": x["distance"] >= LEAST_DISTANCE}
        for key, x in known.items()
        if "error" not in x
    ]
    isolable = [x for x in found if x["is_isolable"]]
    grouped = [x for x in found if x["verdict"] in ("NAMED", "AMBIGUOUS")]
    measures = [
        Measure(what="cases", value=float(len(known)), unit="", bar=float(n), at_least=True),
        share_of("wrong single name", found, is_wrong, bar=0.03),
        share_of("isolable", found, lambda x: bool(x["is_isolable"])),
        share_of("truth named or in the group", grouped, is_in_group, bar=0.95, at_least=True),
        share_of("unexplained", found, lambda x: bool(x["verdict"] == "UNEXPLAINED")),
    ]
    if isolable:
        measures.insert(
            3, share_of("right name of the isolable", isolable, is_right, bar=0.8, at_least=True)
        )
        measures.insert(
            4,
            share_of("the only name of the isolable, also with a doubt", isolable, _is_only_name),
        )
    apart = [x for x in found if (x["nearest"] or 0.0) >= LEAST_DISTANCE]
    if apart:
        what = "right name where every other cause, refitted in full, lies 5 units or more away"
        measures.insert(5, share_of(what, apart, is_right))
    for subject, effect in product(KNEES, HIDDEN):
        own = [x for x in found if x["knee"] == subject and x["effects"] == [effect]]
        if own:
            measures.append(share_of(f"right name, {effect} of {subject}", own, is_right))
    return Row(
        line="blind, menisci, wrapping and capsule hidden in two knees of four lines, 120 cases: "
        "wrong single name <= 3 %, right name >= 80 % of the isolable, truth in the group >= 95 %",
        measures=measures,
        notes=[
            f"{len(known)} of {n} cases",
            *(f"no case: {x['error']}" for x in known.values() if "error" in x),
            *(told(x) for x in found if is_wrong(x)),
        ],
    )
