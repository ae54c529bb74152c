"""What of the record can be computed again alone."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from compute import NOISE, SEED, Item, forced_trials, forces, ligaments, open_ends, pair_profile
from compute import untested as profile_untested

Row = dict[str, Any]


def entries(record: Row) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """Name, recorded value and a function that computes it again."""
    for name, part in record["knees"].items():
        own: Item = (name, NOISE, SEED)
        for ligament, row in zip(ligaments(name), part["pairs"], strict=True):
            yield f"{name}, pair of {ligament}", row, partial(pair_profile, (own, ligament))
        for trial in forced_trials():
            rows = {"rows": [x for x in part["forces"] if x["trial"] == trial]}
            yield f"{name}, forces in {trial}", rows, partial(force_rows, own, trial)
        for row in part["untested"]:
            again = partial(profile_untested, (own, row["trial"]))
            yield f"{name}, untested {row['trial']}", row, again
        for row in part["noises"]:
            item = (name, row["noise"], row["seed"])
            yield (
                f"{name}, noise {row['noise']:g}, seed {row['seed']}",
                row,
                partial(open_ends, item),
            )


def force_rows(item: Item, trial: str) -> Row:
    """The forces of all ligaments in one trial."""
    return {"rows": forces((item, trial))}
