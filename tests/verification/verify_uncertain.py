"""Coverage of 95 % intervals where insertions, frames and loads are wrong and said to be.

The data come from the generator of blind cases, which shares neither contact nor solver with the
model, on a knee whose insertions, frames or loads are not those given. An interval covers the truth
if the profile deviance there is at most the threshold above its minimum. Forces are each ligament's
in the trial that truly loads it most.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from requirement_rows import Measure, Row, commit
from scipy.stats import binomtest, chi2
from uncertain_replicates import LAWS, Stated, UncertainTask, uncertain_replicate
from work_store import work_store

from identknee.blind.conditions import Conditions
from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map

LEVEL, CELLS = 0.95, 16
N_PARTS, A_PART = 30, 10
# Of these parts, those that draw more than the cases whose every cell has a bar.
N_PARTS_OF_ALL = 10
FIRST_SEED = 310_000
IMPROBABLE = 1e-3


def _insertions(actual: float, stated: float) -> Stated:
    return Stated(
        name=f"insertions {actual:g} mm, stated {stated:g} mm",
        conditions=Conditions(insertion_mm=actual),
        uncertainty=replace(LAWS, insertions_mm=stated),
        is_right=actual == stated,
    )


CASES = (
    ("reference", _insertions(1.0, 1.0)),
    ("reference", _insertions(2.0, 2.0)),
    ("lenhart2015_stable", _insertions(1.0, 1.0)),
    ("lenhart2015_stable", _insertions(2.0, 2.0)),
    ("reference", _insertions(2.0, 1.0)),
    ("reference", _insertions(1.0, 2.0)),
    (
        "reference",
        Stated(
            name="load axes 3 deg",
            conditions=Conditions(load_axes_deg=3.0),
            uncertainty=replace(LAWS, load_axes_deg=3.0),
        ),
    ),
    (
        "reference",
        Stated(
            name="registration 2 deg and 2 mm",
            conditions=Conditions(registration_deg=2.0, registration_mm=2.0),
            uncertainty=replace(LAWS, registration_deg=2.0, registration_mm=2.0),
        ),
    ),
    (
        "reference",
        Stated(
            name="insertions 2 mm, load axes 3 deg, registration 2 deg and 2 mm",
            conditions=Conditions(
                insertion_mm=2.0, load_axes_deg=3.0, registration_deg=2.0, registration_mm=2.0
            ),
            uncertainty=replace(
                LAWS,
                insertions_mm=2.0,
                load_axes_deg=3.0,
                registration_deg=2.0,
                registration_mm=2.0,
            ),
        ),
    ),
)
IN_EVERY_PART = CASES[:4]


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row with every part more: so many replicates of each case."""
    done: list[tuple[UncertainTask, dict[str, Any]]] = []
    about = {"cases": repr(CASES), "commit": commit()}
    with work_store("uncertain", about) as store:
        for part in range(N_PARTS):
            tasks = [
                UncertainTask(subject=subject, stated=stated, seed=FIRST_SEED + part * A_PART + i)
                for i in range(A_PART)
                for subject, stated in (CASES if part < N_PARTS_OF_ALL else IN_EVERY_PART)
            ]
            with process_pool(options.workers) as executor:
                outcomes = resumable_map(
                    uncertain_replicate,
                    tasks,
                    executor=executor,
                    store=store,
                    name=f"part {part}",
                    description=f"part {part + 1} of {N_PARTS}",
                )
            done += zip(tasks, outcomes, strict=True)
            yield _row(done, part + 1)


def _row(done: list[tuple[UncertainTask, dict[str, Any]]], part: int) -> Row:
    measures: list[Measure] = []
    notes = [] if part == N_PARTS else [f"unfinished: {part} of {N_PARTS} parts"]
    for subject, stated in CASES:
        own = [y for x, y in done if x.subject == subject and x.stated == stated]
        measures += _measures(f"{subject}, {stated.name}", own, is_right=stated.is_right)
        errors = sum("error" in x for x in own)
        if errors:
            notes.append(f"{subject}, {stated.name}: {errors} of {len(own)} draws gave no data")
    return Row(
        line="coverage of 95 % profile intervals over uncertain geometry, 8 parameters and 4 "
        "forces, >= 300 replicates of insertions wrong by 1 and 2 mm on both knees, 100 of the "
        "rest: each cell's Clopper-Pearson interval (level 1 - 0.05/16) contains 95 %, mean "
        "93-97 %",
        measures=measures,
        notes=notes,
    )


def _measures(where: str, outcomes: list[dict[str, Any]], *, is_right: bool) -> list[Measure]:
    made = [x for x in outcomes if "error" not in x]
    if not made:
        return []
    warned = np.mean([x["misfit_p_value"] < IMPROBABLE for x in made])
    sds = np.median([x["sds"] for x in made], axis=0)
    half = len(sds) // 2
    return [
        *_coverage(f"{where}: parameters", [x["rises"] for x in made], has_bar=is_right),
        *_coverage(f"{where}: forces", [x["force_rises"] for x in made], has_bar=is_right),
        Measure(
            what=f"{where}: data sets whose misfit is beyond noise (p < 0.001)",
            value=100.0 * float(warned),
            unit="%",
            count=len(made),
        ),
        Measure(
            what=f"{where}: median standard deviation of a stiffness",
            value=float(sds[:half].mean()),
            unit="kN",
            count=len(made),
        ),
        Measure(
            what=f"{where}: median standard deviation of a reference strain",
            value=float(sds[half:].mean()),
            unit="%",
            count=len(made),
        ),
        Measure(
            what=f"{where}: simulations a replicate",
            value=float(np.median([x["n_simulations"] for x in made])),
            unit="",
            count=len(made),
        ),
    ]


def _coverage(what: str, rises: list[list[float]], *, has_bar: bool) -> list[Measure]:
    covered = np.array(rises) <= chi2.ppf(LEVEL, 1)
    level = 1.0 - (1.0 - LEVEL) / CELLS
    limits = [
        binomtest(int(k), len(rises)).proportion_ci(level, "exact") for k in covered.sum(axis=0)
    ]
    away = sum(not x.low <= LEVEL <= x.high for x in limits)
    whole = binomtest(int(covered.sum()), covered.size).proportion_ci(LEVEL, "exact")
    return [
        Measure(
            what=f"{what}, mean coverage away from 95 %",
            value=abs(100.0 * float(covered.mean()) - 95.0),
            unit="%",
            bar=2.0 if has_bar else None,
            low=100.0 * float(whole.low),
            high=100.0 * float(whole.high),
            count=len(rises),
            interval="of the coverage, exact binomial at 95 % as if cells were independent",
        ),
        Measure(
            what=f"{what}, cells without 95 % in their interval",
            value=away,
            unit="",
            bar=0 if has_bar else None,
            count=covered.shape[1],
        ),
    ]
