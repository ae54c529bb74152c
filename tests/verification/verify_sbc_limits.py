"""Simulation-based calibration where limits of plausibility count, of knees within them."""

import argparse

import numpy as np
from knees import model
from limit_replicates import limit_ranks
from requirement_rows import Measure, Row
from sbc_replicates import N_DRAWS, simultaneous_level
from work_store import work_store

from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map

N, FIRST_SEED, LEVEL = 100, 395_000, 0.05 / 8


def measure(options: argparse.Namespace) -> Row:
    """Level of the ranks' distribution function by parameter, beside the level of the band."""
    with work_store("sbc_limits", {"n": N}) as store, process_pool(options.workers) as executor:
        found = resumable_map(
            limit_ranks,
            [FIRST_SEED + i for i in range(N)],
            executor=executor,
            store=store,
            description="calibration with limits",
        )
    ranks = np.array([x["ranks"] for x in found if x["ranks"] is not None])
    measures = [
        Measure(
            what=f"{name}: level of its ranks",
            value=simultaneous_level(column, N_DRAWS),
            unit="",
            bar=LEVEL,
            at_least=True,
            count=len(ranks),
        )
        for name, column in zip(model("reference").parameters.names, ranks.T, strict=True)
    ]
    simulations = np.median([x["n_simulations"] for x in found])
    redrawn = sum(x["n_redrawn"] for x in found)
    return Row(
        line="simulation-based calibration with limits, reference, 100 replicates: rank ECDF "
        "inside simultaneous bands at level 1 - 0.05/8 for all 8 parameters",
        measures=measures,
        notes=[
            (
                f"{N - len(ranks)} replicates without 100 draws; {simulations:.0f} simulations a "
                f"replicate; {redrawn} truths drawn again: a trial is lost or a ligament fails"
            )
        ],
    )
