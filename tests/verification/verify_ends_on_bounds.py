"""Ends of profiles that hang on the bounds of other parameters, against profiles in a wider box.

With 4 to 20 measured values some ends are made by the box: the oracle fits and profiles again with
every bound doubled (stiffnesses to 80 kN, strains to 30 %), and an end that it moves by more than a
tenth of the interval hangs on a bound. No such parameter may be called identifiable.
"""

import argparse
from collections import Counter
from typing import Any

from few_values import BUDGET, KNEES, NOISE, ORACLE_BUDGET, ends_of_data_set
from requirement_rows import Measure, Row
from work_store import work_store

from identknee.identify.profile.result import ProfileVerdict
from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map

SETS = 26  # of each knee
WORKERS = 1
IDENTIFIABLE = ProfileVerdict.IDENTIFIABLE.value


def measure(options: argparse.Namespace) -> Row:
    """How many ends hang on a bound, how many of these are found, and what is identifiable."""
    tasks = [(knee, seed) for seed in range(SETS) for knee in KNEES]
    with (
        work_store("ends_on_bounds", {"noise": NOISE, "budgets": [BUDGET, ORACLE_BUDGET]}) as store,
        process_pool(WORKERS) as executor,
    ):
        found = resumable_map(
            ends_of_data_set, tasks, executor=executor, store=store, description="few values"
        )
    ends = [x for one in found for x in one["ends"]]
    judged = [x for x in ends if x["moves"] is not None]
    hanging = [x for x in judged if x["moves"]]
    origins = Counter(_origin(x) for x in ends)
    missed = Counter(f"{x['verdict']}, {_origin(x)}" for x in hanging if _origin(x) != "bound")
    said = [x for x in judged if _origin(x) == "bound"]
    false = [x for x in hanging if x["verdict"] == IDENTIFIABLE]
    identifiable = [x for x in ends if x["verdict"] == IDENTIFIABLE]
    unjudged = sum(x["moves"] is None for x in identifiable)
    return Row(
        line=f"{len(tasks)} data sets of 4 to 20 values at {NOISE:g} mm and deg, reference and "
        "lenhart2015_stable: 0 of the ends that move by more than a tenth of their interval with "
        "every bound doubled belong to a parameter called identifiable",
        measures=[
            _count("such ends of a parameter called identifiable", len(false), len(hanging), bar=0),
            _count("ends of closed sets that the oracle moves", len(hanging), len(judged)),
            _count(
                "of these said to hang on a bound",
                sum(_origin(x) == "bound" for x in hanging),
                len(hanging),
            ),
            _count(
                "ends said to hang on a bound that the oracle leaves where they are",
                sum(not x["moves"] for x in said),
                len(said),
            ),
            _count("ends said to hang on a bound", origins["bound"], len(ends)),
            _count("parameters called identifiable", len(identifiable) // 2, 8 * len(tasks)),
        ],
        notes=[
            "origins of closed ends: " + _listed(origins),
            "moved by the oracle and said to be made by something else: " + _listed(missed),
            f"not judged, because the oracle did not finish: {unjudged} ends of identifiable ones",
            f"{sum(sum(x['n_simulations']) for x in found)} simulations in all profiles",
        ],
    )


def _origin(end: dict[str, Any]) -> str:
    return end["made_by"] or "not found out"


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{n} {word}" for word, n in counts.most_common()) or "none"


def _count(what: str, value: int, of: int, bar: float | None = None) -> Measure:
    return Measure(what=what, value=value, unit="", bar=bar, count=of)
