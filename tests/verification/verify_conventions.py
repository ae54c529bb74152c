"""Broken conventions of tables of unstated noise: planted ones are named, sound tables are not."""

import argparse
from collections.abc import Iterator
from itertools import islice
from typing import Any

from planted_conventions import PLANTED, drawn_table, moved_by
from requirement_rows import Measure, Row
from scipy.stats import binomtest
from work_store import work_store

from identknee.checks.broken_convention import find_broken_convention
from identknee.checks.usable_trials import table_model

# S192803 takes as long as the other knees together.
KNEES = (
    "reference",
    "lenhart2015_stable",
    "reference",
    "lenhart2015_stable",
    "reference",
    "s192803",
)
N_CASES = 480  # of each kind; three of four conventions drawn move their table
MOVED = 3.0  # units of the noise from which a convention must be named
LEAST, EVERY = 300, 20


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """The row, again after every few cases."""
    del options
    done: list[dict[str, Any]] = []
    with work_store("conventions", {"n": N_CASES, "knees": list(KNEES)}) as store:
        cases = _cases()
        while some := list(islice(cases, EVERY)):
            for kind, knee, seed in some:
                key = f"{kind} {seed}"
                if (found := store.get(key)) is None:
                    found = _planted(knee, seed) if kind == "planted" else _sound(knee, seed)
                    store.put_many({key: found})
                done.append({"kind": kind, "knee": knee, **found})
            yield _row(done)


def _cases() -> Iterator[tuple[str, str, int]]:
    for seed in range(N_CASES):
        knee = KNEES[seed % len(KNEES)]
        yield "planted", knee, seed
        yield "sound", knee, seed


def _planted(knee: str, seed: int) -> dict[str, Any]:
    """A planted convention: how far it moves the table, and whether it is named."""
    # Each place of the knees goes through all conventions, in steps that do not meet.
    turn, place = divmod(seed, len(KNEES))
    title = list(PLANTED)[(turn + 9 * place) % len(PLANTED)]
    planted, drawn = PLANTED[title], drawn_table(knee, seed)
    try:
        broken, moved = planted.broken(drawn.laxity), moved_by(drawn, planted)
    except ValueError:
        # No file of the kind would be read.
        return {"title": title, "moved": None, "is_named": False, "said": "refused"}
    model, _ = table_model(drawn.model.knee, broken)
    found = find_broken_convention(model, broken, model.parameters.start)
    said = "nothing" if found is None else " or ".join((found.what, *found.others))
    return {
        "title": f"{title}, seed {seed}",
        "moved": min(moved, 1e9),
        "is_named": planted.is_named(found),
        "said": said,
    }


def _sound(knee: str, seed: int) -> dict[str, Any]:
    """A sound table, every other one of a knee that the model is wrong about."""
    drawn = drawn_table(knee, seed, is_wrong=seed % 2 == 1, has_curves=seed % 4 < 2)
    model, _ = table_model(drawn.model.knee, drawn.laxity)
    found = find_broken_convention(model, drawn.laxity, model.parameters.start)
    return {
        "title": f"{drawn.cause or 'nothing wrong'}, seed {seed}",
        "is_accused": found is not None,
        "said": "" if found is None else found.what,
    }


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
