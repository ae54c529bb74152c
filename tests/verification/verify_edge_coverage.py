"""Coverage of 95 % profile sets where the model has no prediction near the truth.

Whole profiles are walked, as a user's are: on ``lenhart2015``, whose four lines fold close to its
own parameters, and on the reference knee with narrow plateaus. A set covers if it contains the
truth or the end on the truth's side is said to be open; how many ends are open stands beside it.
"""

import argparse
from collections import Counter

from edge_replicates import edge_model, edge_replicate
from requirement_rows import Measure, Row
from scipy.stats import binomtest
from work_store import work_store

from identknee.identify.profile.result import ProfileVerdict, SideStatus
from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map

REPLICATES = 200
KNEES = ("lenhart2015", "narrow")
WORKERS = 1
BAR = 93.0
AT_BOUNDARY = SideStatus.OPEN_AT_FEASIBILITY.value


def measure(options: argparse.Namespace) -> Row:
    """Coverage by parameter on both knees, and how the sides ended."""
    measures: list[Measure] = []
    notes: list[str] = []
    for place, knee in enumerate(KNEES):
        tasks = [(knee, (place, i)) for i in range(REPLICATES)]
        with (
            work_store(f"edge_coverage_{knee}", {"knee": knee, "n": REPLICATES}) as store,
            process_pool(WORKERS) as executor,
        ):
            found = resumable_map(
                edge_replicate, tasks, executor=executor, store=store, name=knee, description=knee
            )
        names = edge_model(knee).parameters.names
        covers = [[x["covers"][i] for x in found] for i in range(len(names))]
        measures += [
            _share(f"{knee}, {n}", sum(c), len(c)) for n, c in zip(names, covers, strict=True)
        ]
        total = [x for row in covers for x in row]
        measures.append(_share(f"{knee}, all parameters", sum(total), len(total), bar=BAR))
        sides = Counter(x for one in found for x in (*one["lower"], *one["upper"]))
        at_boundary = sides[AT_BOUNDARY]
        measures.append(
            Measure(
                what=f"{knee}, ends that the model made, of {sides.total()}",
                value=at_boundary,
                unit="",
                bar=0 if knee == "narrow" else None,
                count=sides.total(),
            )
        )
        measures.append(_false_certainty(knee, found))
        words = ", ".join(f"{n} {word}" for word, n in sides.most_common())
        simulations = sum(x["n_simulations"] for x in found) / len(found)
        notes.append(f"{knee}: sides {words}; {simulations:.0f} simulations a replicate")
    return Row(
        line="coverage of 95 % profile sets, 200 replicates at 0.5 mm and deg, on a knee with an "
        "infeasible edge and on one with narrow plateaus: >= 93 %, open ends said to be open; no "
        "end made by the model on narrow plateaus",
        measures=measures,
        notes=notes,
    )


def _share(what: str, k: int, n: int, bar: float | None = None) -> Measure:
    interval = binomtest(k, n).proportion_ci(0.95, "exact")
    return Measure(
        what=what,
        value=100.0 * k / n,
        unit="%",
        bar=bar,
        at_least=True,
        low=100.0 * float(interval.low),
        high=100.0 * float(interval.high),
        count=n,
        interval="Clopper-Pearson 95 %",
    )


def _false_certainty(knee: str, found: list[dict[str, list[str]]]) -> Measure:
    """How many parameters are called identifiable although an end is the model's."""
    n = sum(
        verdict == ProfileVerdict.IDENTIFIABLE.value and AT_BOUNDARY in {low, high}
        for one in found
        for verdict, low, high in zip(one["verdicts"], one["lower"], one["upper"], strict=True)
    )
    return Measure(
        what=f"{knee}, identifiable with an end that the model made",
        value=n,
        unit="",
        bar=0,
        count=sum(len(x["verdicts"]) for x in found),
    )
