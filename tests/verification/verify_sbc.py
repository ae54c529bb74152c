"""Simulation-based calibration: ranks of truths drawn from the prior among their posteriors."""

import argparse
from typing import Any

import numpy as np
from knees import model
from requirement_rows import Measure, Row
from sbc_replicates import N_DRAWS, NOISE, RULE, Replicate, ranks_of, simultaneous_level
from work_store import work_store

from identknee.runs.executors import process_pool
from identknee.runs.store import Store, resumable_map
from identknee.verbs.verb import knee_digest

WORKERS = 2
# Knee, how far the noise is understated, and the number of replicates.
SERIES = (
    ("reference", 1.0, 300),
    ("lenhart2015_stable", 1.0, 60),
    ("reference", 1.5, 100),
)
LEVEL = 0.05 / 8
MOST_RHAT, MOST_SIMULATIONS = 1.05, 3000


def measure(options: argparse.Namespace) -> Row:
    """Level of the ranks' distribution function by parameter, beside the level of the band."""
    measures, notes = [], []
    knees = {name: knee_digest(model(name).knee) for name in {series[0] for series in SERIES}}
    about = {"knees": knees, "series": SERIES, "noise": NOISE, "rule": str(RULE)}
    with work_store("sbc", about) as store:
        for place, (knee, understated, n) in enumerate(SERIES):
            rows = _rows(place, (knee, understated, n), store)
            found, said = _series((knee, understated), rows)
            measures += found
            notes += said
    return Row(
        line="simulation-based calibration, >= 300 replicates on reference (60 on "
        "lenhart2015_stable), 100 independent draws each, split R-hat <= 1.05, <= 3,000 "
        "simulations a replicate: rank ECDF inside simultaneous bands at level 1 - 0.05/8 for all "
        "8 parameters; a likelihood with its sd understated by 1.5 is caught",
        measures=measures,
        notes=notes,
    )


def _rows(place: int, series: tuple[str, float, int], store: Store) -> list[dict[str, Any]]:
    knee, understated, n = series
    tasks = [Replicate(knee=knee, understated=understated, seed=(2, place, i)) for i in range(n)]
    with process_pool(WORKERS) as executor:
        return resumable_map(
            ranks_of,
            tasks,
            executor=executor,
            store=store,
            name=f"{place} {knee} {understated}",
            description=f"{knee}, noise understated by {understated:g}",
        )


def _series(
    series: tuple[str, float], rows: list[dict[str, Any]]
) -> tuple[list[Measure], list[str]]:
    knee, understated = series
    names = model(knee).parameters.names
    ranks = np.array([x["ranks"] for x in rows if x["ranks"] is not None])
    levels = [simultaneous_level(column, N_DRAWS) for column in ranks.T]
    where = f"{knee}, noise understated by {understated:g}" if understated != 1.0 else knee
    if understated != 1.0:
        caught = Measure(
            what=f"{where}: level of the rarest ranks",
            value=min(levels),
            unit="",
            bar=LEVEL,
            count=len(ranks),
        )
        return [caught], [f"{where}: {_described(rows)}"]
    measures = [
        Measure(
            what=f"{where}, {name}: level of its ranks",
            value=level,
            unit="",
            bar=LEVEL,
            at_least=True,
            count=len(ranks),
        )
        for name, level in zip(names, levels, strict=True)
    ]
    cost = [x["n_simulations"] for x in rows]
    rhat = [np.inf if x["rhat"] is None else x["rhat"] for x in rows]
    measures += [
        _most(f"{where}: R-hat", rhat, MOST_RHAT),
        _most(f"{where}: simulations a replicate", cost, MOST_SIMULATIONS),
        _most(f"{where}: replicates without 100 draws", [len(rows) - len(ranks)], 0),
    ]
    return measures, [f"{where}: {_described(rows)}"]


def _most(what: str, values: list[Any], bar: float) -> Measure:
    return Measure(
        what=what,
        value=float(np.max(values)),
        unit="",
        bar=bar,
        low=float(np.min(values)),
        high=float(np.max(values)),
        count=len(values),
        interval="min-max, the value is the largest",
    )


def _described(rows: list[dict[str, Any]]) -> str:
    outcomes = [x["outcome"] for x in rows]
    counts = ", ".join(f"{outcomes.count(x)} {x}" for x in sorted(set(outcomes)))
    redrawn = sum(x["n_redrawn"] for x in rows)
    mean = np.mean([x["n_simulations"] for x in rows])
    return (
        f"{counts}; {mean:.0f} simulations a replicate; {redrawn} truths drawn again because they "
        "have no prediction"
    )
