"""The blind test with one fact varied that the generator and the library otherwise share."""

import argparse
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from blind_axes import AXES, PRIOR, TWICE
from blind_diagnoses import BlindTask, outcome_of
from requirement_rows import Measure, Row, commit
from verify_blind import (
    REAL,
    REFERENCE,
    SIGNALS,
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
from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map

REAL_SIGNALS = (10.0, 20.0)
N_NULLS, LEAST_HIDDEN = 60, 150
# All axes grow together, so that a run cut short tells of each.
N_PARTS = 18
FIRST_SEED = 160_000
# Sized by the prior in place of a signal.
SIZED_BY_PRIOR = (PRIOR, TWICE)


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row with every part more."""
    tasks = _tasks()
    about = {"axes": AXES, "parts": N_PARTS, "tasks": repr(tasks), "commit": commit()}
    found: list[tuple[BlindTask, dict[str, Any]]] = []
    with work_store("blind_axes", about) as store:
        for part in range(N_PARTS):
            own = [x for tasks_of_part in tasks[part::N_PARTS] for x in tasks_of_part]
            with process_pool(options.workers) as executor:
                outcomes = resumable_map(
                    outcome_of,
                    own,
                    executor=executor,
                    store=store,
                    name=f"part {part}",
                    description=f"part {part + 1} of {N_PARTS}",
                )
            found += zip(own, outcomes, strict=True)
            yield _row(found, part + 1)


def _tasks() -> list[list[BlindTask]]:
    """One list an index, of the same case on every axis; the indices in a random order.

    The seeds are the same on every axis, so that axes differ by what they vary alone.
    """
    hidden = [
        *((REFERENCE, x, y) for x, y in product(SIGNALS, LISTED)),
        *((REAL, x, y) for x, y in product(REAL_SIGNALS, LISTED)),
    ]
    cases = [*hidden, *[(REFERENCE, None, None)] * N_NULLS]
    order = np.random.default_rng(0).permutation(len(cases))
    return [[_task(axis, FIRST_SEED + int(i), *cases[i]) for axis in AXES] for i in order]


def _task(
    axis: str, seed: int, subject: str, signal: float | None, effect: str | None
) -> BlindTask:
    return BlindTask(
        subject=subject,
        effects=() if effect is None else (effect,),
        signal=None if axis in SIZED_BY_PRIOR else signal,
        seed=seed,
        measures_gain=False,
        axis=axis,
    )


def _row(found: list[tuple[BlindTask, dict[str, Any]]], n_parts: int) -> Row:
    measures: list[Measure] = []
    notes = [] if n_parts == N_PARTS else [f"unfinished: {n_parts} of {N_PARTS} parts"]
    for axis in AXES:
        nulls = [y for x, y in found if x.axis == axis and not x.effects]
        hidden = [y for x, y in found if x.axis == axis and x.effects]
        measures += _measures(axis, nulls, hidden)
        notes += _notes(axis, nulls, hidden)
    return Row(
        line="blind test with one shared fact varied at a time: wrong single names, false alarms, "
        "right names on each axis",
        measures=measures,
        notes=notes,
    )


def _measures(axis: str, nulls: Outcomes, hidden: Outcomes) -> list[Measure]:
    made = [x for x in hidden if "error" not in x]
    named = [x for x in made if x["verdict"] == "NAMED"]
    return [
        Measure(
            what=f"{axis}: cases with a hidden effect",
            value=len(made),
            unit="",
            bar=LEAST_HIDDEN,
            at_least=True,
        ),
        share_of(f"{axis}: wrong single name", hidden, is_wrong, bar=0.03),
        share_of(f"{axis}: false alarms", nulls, _is_false_alarm, bar=0.08),
        share_of(f"{axis}: right single name", hidden, is_right),
        share_of(f"{axis}: truth named or in the group", hidden, is_in_group),
        share_of(f"{axis}: detected", hidden, is_alarm),
        share_of(f"{axis}: right among single names", named, is_right),
    ]


def _is_false_alarm(outcome: dict[str, Any]) -> bool:
    """Errors common to a flexion angle are no effect; said to be there, they are no alarm."""
    return is_alarm(outcome) and not outcome["correct"]


def _notes(axis: str, nulls: Outcomes, hidden: Outcomes) -> list[str]:
    made = [x for x in hidden if "error" not in x]
    quartiles = np.quantile([x["signal"] for x in made], [0.25, 0.5, 0.75]) if made else []
    signals = ", ".join(f"{x:.1f}" for x in quartiles)
    return [
        verdicts_of(f"{axis}, nulls", nulls),
        f"{verdicts_of(f'{axis}, hidden', hidden)}; quartiles of the signal {signals}",
        *(f"{axis}, no case: {x['error']}" for x in [*nulls, *hidden] if "error" in x),
        *(f"{axis}, {told(x)}" for x in made if is_wrong(x)),
    ]
