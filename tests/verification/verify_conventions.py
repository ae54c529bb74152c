"""Broken conventions of tables of unstated noise: planted ones are named, sound tables are not."""

import argparse
from typing import Any

from planted_conventions import convention_outcome
from requirement_rows import Measure, Row
from scipy.stats import binomtest
from work_store import work_store

from identknee.runs.executors import process_pool
from identknee.runs.store import resumable_map

# S192803 takes as long as the other knees together.
KNEES = (
    "reference",
    "lenhart2015_stable",
    "reference",
    "lenhart2015_stable",
    "reference",
    "s192803",
)
# Seven of ten conventions drawn move their table.
N_PLANTED, N_SOUND = 450, 306
MOVED = 3.0  # units of the noise from which a convention must be named
LEAST = 300


def measure(options: argparse.Namespace) -> Row:
    """Shares named and accused, and all that went wrong."""
    tasks = [
        (kind, KNEES[seed % len(KNEES)], seed, KNEES)
        for kind, n in (("planted", N_PLANTED), ("sound", N_SOUND))
        for seed in range(n)
    ]
    about = {"n": [N_PLANTED, N_SOUND], "knees": list(KNEES)}
    with work_store("conventions", about) as store, process_pool(options.workers) as executor:
        found = resumable_map(
            convention_outcome, tasks, executor=executor, store=store, description="tables"
        )
    return _row(
        [
            {"kind": kind, "knee": knee, **x}
            for (kind, knee, *_), x in zip(tasks, found, strict=True)
        ]
    )


def _row(done: list[dict[str, Any]]) -> Row:
    moved = [x for x in done if x["kind"] == "planted" and (x["moved"] or 0.0) >= MOVED]
    sound = [x for x in done if x["kind"] == "sound"]
    named, accused = [x["is_named"] for x in moved], [x["is_accused"] for x in sound]
    measures = [_share("planted conventions named", named, bar=95.0, at_least=True)]
    for knee in dict.fromkeys(KNEES):
        own = [x["is_named"] for x in moved if x["knee"] == knee]
        measures.append(_share(f"named on {knee}", own))
    measures.append(_share("sound tables accused of one", accused, bar=1.0))
    n_planted = sum(x["kind"] == "planted" for x in done)
    measures += [
        Measure(what=what, value=n, unit="", bar=LEAST, at_least=True)
        for what, n in (("planted tables that move", len(moved)), ("sound tables", len(sound)))
    ]
    notes = [
        f"{n_planted} planted, of which {len(moved)} move the table; {len(sound)} sound",
        *(f"{x['knee']}, {x['title']}: {x['said']}" for x in moved if not x["is_named"]),
        *(f"{x['knee']}, {x['title']}: {x['said']}" for x in sound if x["is_accused"]),
    ]
    return Row(
        line="conventions broken without a stated noise, on 2 knees and s192803, that move the "
        "table by >= 3 noise units beside frames and load axes: named >= 95 %; sound tables, half "
        "of them with a wrong model: accused <= 1 %",
        measures=measures,
        notes=notes,
    )


def _share(
    what: str, values: list[bool], bar: float | None = None, *, at_least: bool = False
) -> Measure:
    k, n = sum(values), max(len(values), 1)
    interval = binomtest(k, n).proportion_ci(0.95, "exact")
    return Measure(
        what=what,
        value=100.0 * k / n,
        unit="%",
        bar=bar,
        at_least=at_least,
        low=100.0 * float(interval.low),
        high=100.0 * float(interval.high),
        count=len(values),
        interval="95 % interval",
    )
