"""Simulation-based calibration of a knee tested intact, cut and cut in part, with an ACL force."""

import argparse

import numpy as np
from experiment_replicates import EVERY_SAMPLED, FORCES_SAMPLED, experiment_ranks, state_model
from requirement_rows import Measure, Row
from sbc_replicates import N_DRAWS, simultaneous_level
from work_store import work_store

from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map

N, FIRST_SEED = 100, 398_000


def measure(options: argparse.Namespace) -> Row:
    """Level of the ranks' distribution function by parameter, beside the level of the band."""
    about = {"n": N, "every": EVERY_SAMPLED, "forces": list(FORCES_SAMPLED)}
    with work_store("sbc_states", about) as store, process_pool(options.workers) as executor:
        found = resumable_map(
            experiment_ranks,
            [FIRST_SEED + i for i in range(N)],
            executor=executor,
            store=store,
            description="calibration with states",
        )
    ranks = np.array([x["ranks"] for x in found if x["ranks"] is not None])
    names = state_model().parameters.names
    measures = [
        Measure(
            what=f"{name}: level of its ranks",
            value=simultaneous_level(column, N_DRAWS),
            unit="",
            bar=0.05 / len(names),
            at_least=True,
            count=len(ranks),
        )
        for name, column in zip(names, ranks.T, strict=True)
    ]
    simulations = np.median([x["n_simulations"] for x in found])
    redrawn = sum(x["n_redrawn"] for x in found)
    return Row(
        line="simulation-based calibration with the MCL cut, the LCL cut by half and the force "
        "of the ACL, 100 replicates: rank ECDF inside simultaneous bands at level 1 - 0.05/9 "
        "for the 8 parameters of reference and the share that the partial cut leaves",
        measures=measures,
        notes=[
            (
                f"{N - len(ranks)} replicates without 100 draws; {simulations:.0f} simulations a "
                f"replicate; {redrawn} truths drawn again: a trial is lost"
            )
        ],
    )
