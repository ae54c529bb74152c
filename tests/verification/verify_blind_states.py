"""Blind cases of a knee intact and cut on two rigs: an effect of one state, one rig's error.

A case is isolable where what it hides is in no group of the planned isolability, and as far out of
the noise as that takes each cause to be. The second condition was added after 27 cases of other
seeds were seen; the rate without it stands beside.
"""

import argparse
from collections.abc import Iterator
from typing import Any

from requirement_rows import Measure, Row
from state_cases import ONE_RIG, ONE_STATE, SOUND, planned, state_outcome, subject
from verify_blind import is_alarm, share_of
from work_store import work_store

from identknee.blind.case import SD
from identknee.diagnosis.advice import ROOT, protocol_isolability

KNEES = ("reference", "lenhart2015_stable")
KINDS = (ONE_STATE, ONE_RIG, SOUND)
FIRST_SEED, EVERY, N = 500_000, 3, 20


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row, again after every few cases."""
    del options
    done: list[dict[str, Any]] = []
    with work_store("blind_states", {"n": N, "seed": FIRST_SEED}) as store:
        apart = {}
        for name in KNEES:
            if (groups := store.get(name)) is None:
                groups = _not_isolable(name)
                store.put_many({name: groups})
            apart[name] = set(groups)
        tasks = [(name, kind, i) for i in range(N) for name in KNEES for kind in KINDS]
        for k, (name, kind, number) in enumerate(tasks):
            key = f"{name} {kind} {number}"
            if (found := store.get(key)) is None:
                found = state_outcome(name, kind, number, FIRST_SEED + 100 * k)
                store.put_many({key: found})
            is_seen = min(found.get("signals") or [0.0]) >= ROOT
            is_alone = not apart[name] & set(found["hidden"])
            done.append({**found, "is_alone": is_alone, "is_isolable": is_seen and is_alone})
            if (k + 1) % EVERY == 0:
                yield _row(done)
    yield _row(done)


def _not_isolable(name: str) -> list[str]:
    """What the planned trials cannot tell from something else, before there are data."""
    found = protocol_isolability(subject(name), planned().protocol, sd_mm=SD, sd_deg=SD)
    if found is None:  # pragma: no cover - both knees have predictions
        raise AssertionError
    return sorted({"insertion"}.union(*found.groups))


def _row(done: list[dict[str, Any]]) -> Row:
    hidden = [x for x in done if x["hidden"]]
    sound = [x for x in done if not x["hidden"] and "error" not in x]
    diagnosed = [x for x in hidden if "error" not in x]
    measures = [
        Measure(what="cases", value=float(len(done)), unit="", bar=120.0, at_least=True),
        share_of("wrong single name", diagnosed, _is_wrong, bar=0.03),
        share_of("isolable", diagnosed, lambda x: bool(x["is_isolable"])),
    ]
    isolable = [x for x in diagnosed if x["is_isolable"]]
    if isolable:
        measures.append(
            share_of("right name of the isolable", isolable, _is_right, bar=0.85, at_least=True)
        )
    if alone := [x for x in diagnosed if x["is_alone"]]:
        measures.append(share_of("right name of those in no group, of any size", alone, _is_right))
    for kind in (ONE_STATE, ONE_RIG):
        own = [x for x in isolable if x["kind"] == kind]
        if own:
            measures.append(share_of(f"right name of the isolable, {kind}", own, _is_right))
    if sound:
        measures.append(share_of("false alarms", sound, is_alarm, bar=0.08))
    missed = [
        f"{x['knee']}, {' and '.join(x['hidden'])}: {x['verdict']} {', '.join(x['named'])}"
        for x in diagnosed
        if _is_wrong(x) or (x["is_isolable"] and not _is_right(x))
    ]
    seconds = sorted(x["seconds"] for x in done if "seconds" in x)
    return Row(
        line="blind, two knees with a capsule, intact and cut ACL, two rigs: an effect in one "
        "state, one rig's error beside a knee's effect, sound; 120 cases",
        measures=measures,
        notes=[
            f"{len(done)} of {N * len(KNEES) * len(KINDS)} cases",
            f"a diagnosis takes {seconds[len(seconds) // 2]:.0f} s (median, processor time)",
            *(f"no case: {x['error']}" for x in done if "error" in x),
            *missed,
        ],
    )


def _is_right(x: dict[str, Any]) -> bool:
    return bool(x["verdict"] == "NAMED" and x["named"] == x["hidden"])


def _is_wrong(x: dict[str, Any]) -> bool:
    return bool(x["verdict"] == "NAMED" and set(x["named"]) - set(x["hidden"]))
