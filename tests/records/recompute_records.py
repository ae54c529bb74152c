"""Compute a random share of the numbers in a few studies' records again, and compare.

Run as ``python tests/records/recompute_records.py``. A study takes part once its folder has a
``recompute.py`` with a function `entries`, which gives of every entry that can be computed alone
its name, what was recorded, and a function that computes it again.
"""

import argparse
import json
import random
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "studies"))

from common.records import commit, knee_digest, rounded, study_knee

from identknee.runs.files import plain

STUDIES = Path(__file__).parents[2] / "studies"
SHARE = 0.001
# How many studies a draw is of.
N_STUDIES = 5
# What the entries drawn from one study may take together, by the times recorded with them [s].
MOST_SECONDS = 3.0
MOST_SHOWN = 5
# Of these one number alone takes half a minute: they are computed again where all are.
NIGHTLY = {"16_what_a_cut_is_worth"}
# Records keep six digits, and the last one may be rounded the other way.
RELATIVE = 1e-5
# Errors of a fit that found the truth are rounding [kN, %, mm, deg, N]; nothing smaller matters.
ABSOLUTE = 1e-6
# Words may change; the numbers they are made of stand beside them.
NOT_COMPARED = {"seconds", "sentence"}
# How long a search went on may hang on its last bits, and so on the processor: where it ended does
# not, which is compared beside it.
WORK = {"n_simulations", "n_polishing"}
WORK_RELATIVE, WORK_ABSOLUTE = 0.05, 2
# A score of a cause stands where a diagnosis' fit ended, which is known to 1e-4 of its deviance:
# machine code compiled elsewhere moved one by 1.1e-4.
SCORES, SCORE_RELATIVE = ("score",), 1e-3
# Records older than a change of what they record, or of searches that hang on the last bits of an
# equilibrium, and so on the processor. One that ends within 5e-12 mm of where it ended leads such
# searches to another end (03, 09) and bootstraps of ranks to others (07). Fits of gross misfit, as
# with wrong insertions that are not stated, find lower ends since others begin with each stiffness
# nearly gone (12). They are computed again where all are, and differences fail nothing. Nothing
# else belongs here.
SUPERSEDED = {
    "03_basin_of_attraction",
    "07_global_sensitivity",
    "09_optimizers",
    "12_geometry_uncertainty",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Entry:
    """A part of a record that can be computed alone."""

    name: str
    recorded: Any
    recompute: Callable[[], Any]

    @property
    def n_numbers(self) -> int:
        """How many numbers it holds."""
        return count(self.recorded)

    @property
    def seconds(self) -> float:
        """How long it took when it was recorded, where it says so."""
        return float(self.recorded.get("seconds") or 0.0)


def main() -> int:
    """Exit code: 1 where anything differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=zlib.crc32(commit().encode()))
    parser.add_argument("--share", type=float, default=SHARE)
    parser.add_argument("--study", help="the folder of one study; all of them without")
    parser.add_argument("--seconds", type=float, default=MOST_SECONDS, help="of one study")
    options = parser.parse_args()
    began = time.perf_counter()
    n = 0
    problems: list[str] = []
    known: list[str] = []
    drawn = studies()
    if options.share < 1.0:
        quick = [x for x in drawn if x not in NIGHTLY | SUPERSEDED]
        drawn = random.Random(options.seed).sample(quick, N_STUDIES)
    for study in [options.study] if options.study else drawn:
        for path in sorted((STUDIES / study / "records").glob("*.json")):
            record = json.loads(path.read_text(encoding="utf-8"))
            problems += [f"{study}: {x}" for x in head_problems(record)]
            entries = [Entry(name=x, recorded=y, recompute=z) for x, y, z in load(study)(record)]
            n_wanted = int(np.ceil(options.share * count(record["knees"])))
            for entry in draw(entries, n_wanted, options.seed, options.seconds):
                found = differences(entry.recorded, rounded(plain(entry.recompute())))
                told = known if study in SUPERSEDED else problems
                told += [f"{study}: {entry.name}: {x}" for x in found]
                n += entry.n_numbers
                print(f"{study}: {entry.name}: {entry.n_numbers} numbers", flush=True)
    print(f"{n} numbers computed again in {time.perf_counter() - began:.0f} s")
    print(f"the same again: python {sys.argv[0]} --seed {options.seed} --share {options.share}")
    if known:
        print(f"{len(known)} differ in records that are to be computed again, among them:")
        print("\n".join(known[:MOST_SHOWN]))
    print("\n".join(problems) or "all others are those recorded")
    return int(bool(problems))


def studies() -> list[str]:
    """Folders of the studies whose entries can be computed again."""
    return sorted(x.parent.name for x in STUDIES.glob("*/recompute.py"))


def load(study: str) -> Callable[[Any], Iterable[tuple[str, Any, Callable[[], Any]]]]:
    """The function `entries` of a study, whose modules import those beside them by plain names."""
    folder = STUDIES / study
    beside = {x.stem for x in folder.glob("*.py")}
    sys.path.insert(0, str(folder))
    for name in beside:
        sys.modules.pop(name, None)
    try:
        spec = spec_from_file_location(f"recompute_{study}", folder / "recompute.py")
        assert spec is not None
        assert spec.loader is not None
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(folder))
        for name in beside:
            sys.modules.pop(name, None)
    return module.entries  # type: ignore[no-any-return]


def head_problems(record: Any) -> list[str]:
    """What the head lacks, and the inputs that are not those of the record any more."""
    head = record["head"]
    problems = [f"no {x} in the head" for x in ("command", "commit", "inputs") if not head.get(x)]
    for name, digest in head["inputs"].items():
        if knee_digest(study_knee(name)) != digest:
            problems.append(f"{name} is another knee now: compute the study again")
    return problems


def draw(
    entries: Iterable[Entry], n_wanted: int, seed: int, left: float = MOST_SECONDS
) -> Iterator[Entry]:
    """Entries at random, each the likelier the more numbers it holds, until enough are drawn.

    None takes longer than what is `left` of the time [s], as it was recorded.
    """
    pool = list(entries)
    generator = np.random.default_rng(seed)
    while n_wanted > 0 and (pool := [x for x in pool if x.n_numbers and x.seconds <= left]):
        weights = np.array([x.n_numbers for x in pool], float)
        entry = pool.pop(int(generator.choice(len(pool), p=weights / weights.sum())))
        n_wanted -= entry.n_numbers
        left -= entry.seconds
        yield entry


def differences(recorded: Any, found: Any) -> list[str]:
    """Every place where the two differ, with both values."""
    old, new = dict(leaves(recorded)), dict(leaves(plain(found)))
    return [
        f"{place or 'value'} was {old.get(place, 'absent')}, is {new.get(place, 'absent')}"
        for place in {**old, **new}
        if place not in old or place not in new or not is_same_at(place, old[place], new[place])
    ]


def is_same_at(place: str, old: Any, new: Any) -> bool:
    """Whether two values are one: the work that a fit took and scores at its end only nearly."""
    name = place.split(".")[-1].split("[")[0]
    if is_number(old) and is_number(new):
        if name in WORK:
            return bool(abs(old - new) <= max(WORK_ABSOLUTE, WORK_RELATIVE * max(old, new)))
        if name in SCORES:
            return bool(abs(old - new) <= max(ABSOLUTE, SCORE_RELATIVE * max(abs(old), abs(new))))
    return is_same(old, new)


def is_same(old: Any, new: Any) -> bool:
    """Whether two values are one, numbers as far as a record keeps them."""
    if is_number(old) and is_number(new):
        return bool(abs(old - new) <= max(ABSOLUTE, RELATIVE * max(abs(old), abs(new))))
    return bool(old == new)


def leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Every single value with its place, times left out."""
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in NOT_COMPARED:
                yield from leaves(item, f"{place}.{key}" if place else key)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from leaves(item, f"{place}[{i}]")
    else:
        yield place, value


def count(value: Any) -> int:
    """How many numbers it holds."""
    return sum(1 for _, x in leaves(value) if is_number(x))


def is_number(value: Any) -> bool:
    """Whether it is a number and no truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool)


if __name__ == "__main__":
    sys.exit(main())
