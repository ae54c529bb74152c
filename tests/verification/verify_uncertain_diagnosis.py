"""Diagnosis of knees whose insertions are wrong by 1.5 and 2 mm, stated to 2 mm.

The data come from the generator of blind cases. A signal counts beyond the geometry: what the model
leaves of the data without noise when insertions vary within their prior.
"""

import argparse
from collections.abc import Iterator
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from knees import knee
from rows import Measure, Row, commit
from uncertain_diagnoses import UncertainCase, uncertain_outcome
from verify_blind import (
    NOISE,
    REAL,
    REFERENCE,
    Outcomes,
    is_alarm,
    is_in_group,
    is_right,
    is_wrong,
    share_of,
    told,
    verdicts_of,
)
from work_store import work_store

from identknee.blind.effects import LISTED
from identknee.diagnosis.advice import protocol_isolability
from identknee.laxity.protocol import load_protocol
from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map
from identknee.subject.knee import Uncertainty

STATED_MM, ACTUAL_MM = 2.0, (1.5, 2.0)
# As the blind generator sizes them, geometry known: beyond the geometry less is left.
SIGNALS = (12.0, 25.0)
N_NULLS, N_SEEDS = 60, 2  # of each knee
HIDDEN = tuple(x for x in LISTED if x != "insertion")
CLEAR, POWERFUL = 10.0, 0.95
# Of a claimed power, where it is compared with what is found.
POWERS = ((0.0, 0.5), (0.5, 0.95), (0.95, 1.01))
N_PARTS = 32
FIRST_SEED = 330_000
MOST_SECONDS = 30.0


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row with every part more: the same share of nulls and of effects on both knees."""
    tasks = _tasks()
    about = {"tasks": repr(tasks), "parts": N_PARTS, "commit": commit()}
    found: list[tuple[UncertainCase, dict[str, Any]]] = []
    with work_store("uncertain_diagnosis", about) as store:
        for part in range(N_PARTS):
            own = tasks[part::N_PARTS]
            with process_pool(options.workers) as executor:
                outcomes = resumable_map(
                    uncertain_outcome,
                    own,
                    executor=executor,
                    store=store,
                    name=f"part {part}",
                    description=f"part {part + 1} of {N_PARTS}",
                )
            found += zip(own, outcomes, strict=True)
            yield _row(found, part + 1)


def _tasks() -> list[UncertainCase]:
    """Nulls and effects of both knees, in a random order."""
    subjects = (REFERENCE, REAL)
    cases: list[tuple[str, str, float | None]] = [
        *((x, "", None) for x in subjects for _ in range(N_NULLS)),
        *((x, y, z) for x, y, z, _ in product(subjects, HIDDEN, SIGNALS, range(N_SEEDS))),
    ]
    order = np.random.default_rng(0).permutation(len(cases))
    return [
        UncertainCase(
            subject=cases[i][0],
            effect=cases[i][1],
            signal=cases[i][2],
            seed=FIRST_SEED + int(i),
            actual_mm=ACTUAL_MM[i % len(ACTUAL_MM)],
            stated_mm=STATED_MM,
        )
        for i in order
    ]


@cache
def _not_separable(subject: str) -> frozenset[str]:
    """What the 63 trials cannot tell from something else over such insertions."""
    stated = knee(subject).with_uncertainty(Uncertainty(insertions_mm=STATED_MM))
    found = protocol_isolability(stated, load_protocol("seed63"), sd_mm=NOISE, sd_deg=NOISE)
    return frozenset() if found is None else frozenset(x for group in found.groups for x in group)


def _row(found: list[tuple[UncertainCase, dict[str, Any]]], n_parts: int) -> Row:
    made = [(x, y) for x, y in found if "error" not in y]
    hidden = [(x, y) for x, y in made if x.effect]
    outcomes = [y for _, y in hidden]
    nulls = [y for x, y in made if not x.effect]
    ambiguous = [x for x in outcomes if x["verdict"] == "AMBIGUOUS"]
    seconds = [y["seconds"] for _, y in made]
    measures = [
        *(
            share_of(
                f"false alarms, {subject}",
                [y for x, y in made if not x.effect and x.subject == subject],
                is_alarm,
                bar=0.08,
            )
            for subject in (REFERENCE, REAL)
        ),
        share_of("false alarms, both knees", nulls, is_alarm, bar=0.08),
        *_named(hidden),
        share_of("wrong single name, all that hide something", outcomes, is_wrong, bar=0.03),
        share_of(
            "truth in the group when AMBIGUOUS", ambiguous, is_in_group, bar=0.95, at_least=True
        ),
        share_of(
            "nothing seen where the claimed power is at least 95 %",
            [x for x in outcomes if (x.get("power") or 0.0) >= POWERFUL],
            _is_structurally_flat,
            bar=0.05,
        ),
        *_powers(outcomes),
        Measure(
            what="processor time of a diagnosis, median",
            value=float(np.median(seconds)) if seconds else np.nan,
            unit="s",
            bar=MOST_SECONDS,
            low=min(seconds, default=np.nan),
            high=max(seconds, default=np.nan),
            count=len(seconds),
        ),
    ]
    unfinished = [] if n_parts == N_PARTS else [f"unfinished: {n_parts} of {N_PARTS} parts"]
    return Row(
        line="diagnosis over insertions wrong by 1.5 and 2 mm, stated to 2 mm, both knees",
        measures=measures,
        notes=[
            *unfinished,
            verdicts_of("nulls", nulls),
            verdicts_of("hidden", outcomes),
            *(f"no case: {y['error']}" for _, y in found if "error" in y),
            *(told(x) for x in outcomes if is_wrong(x)),
        ],
    )


def _named(hidden: list[tuple[UncertainCase, dict[str, Any]]]) -> list[Measure]:
    clear = [(x, y) for x, y in hidden if y.get("beyond", 0.0) >= CLEAR]
    alone = [y for x, y in clear if x.effect not in _not_separable(x.subject)]
    every = [y for _, y in clear]
    what = f"signal of {CLEAR:g} and more beyond the geometry"
    return [
        share_of(f"right name, separable, {what}", alone, is_right, bar=0.9, at_least=True),
        share_of(f"truth named or in the group, separable, {what}", alone, is_in_group),
        share_of(f"truth named or in the group, {what}", every, is_in_group),
        share_of(f"right name, {what}", every, is_right),
    ]


def _is_structurally_flat(outcome: dict[str, Any]) -> bool:
    return not is_alarm(outcome)


def _powers(outcomes: Outcomes) -> list[Measure]:
    """How far what was found is from the power that was claimed."""
    measures = []
    for low, high in POWERS:
        own = [x for x in outcomes if x.get("power") is not None and low <= x["power"] < high]
        if not own:
            continue
        claimed, reached = (
            100.0 * float(np.mean(x)) for x in ([x["power"] for x in own], list(map(is_alarm, own)))
        )
        measures.append(
            Measure(
                what=f"claimed power of {low:g} to {min(high, 1.0):g}: away from what was found",
                value=abs(claimed - reached),
                unit="%",
                bar=10.0,
                low=claimed,
                high=reached,
                count=len(own),
                interval="claimed and found",
            )
        )
    return measures
