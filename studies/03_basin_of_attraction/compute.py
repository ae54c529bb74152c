"""Slow part of the study: sweeps of starts by least squares and Complex, and the cliffs between.

Writes ``records/basin_of_attraction.json``. Finished searches are kept in stores outside the
checkout, so that the same command resumes where it was stopped.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.problems import exact_problem, model_of, truth_of
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.calibrate.fit import fit
from identknee.identify.sweep import sweep
from identknee.runs.schema import summary_of
from identknee.verbs.sweep import trials_lost

GUESSES = ("IG1", "IG2", "IG3", "IG4")
# kN and %: as the paper counts the distance of its guesses, which are at 0, 0.5, 1.25 and 3.6.
DISTANCES = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.6, 4.5, 6.0)
SEED = 3
# How near the truth an end has to be, in kN and %.
WITHIN = (0.25, 0.5, 1.0)
N_WAYS = {"reference": 400, "lenhart2015_stable": 100, "lenhart2015": 100}
PLANE = 41
N_QUANTILES, N_DRAWN = 201, 200
KEPT = (
    *("n_starts", "n_simulations", "n_polishing", "kinds", "outcomes", "polished_outcomes"),
    *("n_basins", "basins", "unseen_mass", "seconds_per_start"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One sweep of the study: which starts, by which optimizer, how many on each knee.

    Attributes
    ----------
    name
        In the record.
    design
        ``"shells"`` around the truth, ``"bounds"`` for Sobol points, ``"guesses"`` for the paper's
        initial guesses, each with as many seeds.
    method
        The optimizer.
    numbers
        How many starts on each knee; seeds a guess for ``"guesses"``.
    """

    name: str
    design: str
    method: str
    numbers: dict[str, int]


KNEES = ("reference", "lenhart2015_stable", "lenhart2015")


def part(name: str, design: str, method: str, *numbers: int) -> Part:
    """A part with its numbers in the order of `KNEES`."""
    of_knee = dict(zip(KNEES, numbers, strict=True))
    return Part(name=name, design=design, method=method, numbers=of_knee)


PARTS = (
    part("shells_least_squares", "shells", "least-squares", 10_000, 2000, 300),
    part("bounds_least_squares", "bounds", "least-squares", 10_000, 2000, 100),
    part("guesses_complex", "guesses", "complex", 10, 4, 2),
    part("shells_complex", "shells", "complex", 500, 100, 20),
)


def main() -> None:
    """Compute what the stores do not hold yet and write the record."""
    options = records.parsed_options(__file__, "a hundredth of the starts")
    knees = {name: study_knee(name) for name in KNEES}
    numbers = {x.name: x.numbers for x in PARTS}
    record = records.begun(options, KNEES, seed=SEED, distances=DISTANCES, numbers=numbers)
    record["knees"] = {name: described(problem_of(knee)) for name, knee in knees.items()}
    with ik.runs.process_pool(options.workers) as executor:
        for wanted in PARTS:
            for name, knee in knees.items():
                problem = problem_of(knee)
                found = swept(name, problem, wanted, options, executor)
                row = record["knees"][name]
                row["parts"][wanted.name] = part_row(problem, found, wanted)
                write_record(options.record, record)
        for name, knee in knees.items():
            row = record["knees"][name]
            row["cliffs"] = cliff_row(name, problem_of(knee), options, executor)
            row["planes"] = plane_rows(problem_of(knee), 5 if options.quick else PLANE)
            write_record(options.record, record)
            records.say(f"{name}: cliffs and planes")
    records.say(f"written: {options.record.name}")


def problem_of(knee: ik.Knee) -> ik.LaxityResiduals:
    """The data of a knee without noise."""
    return exact_problem(model_of(knee))


def starts_of(problem: ik.LaxityResiduals, design: str, n: int) -> ik.runs.Array:
    """The starts of a design, shape ``(n, p)``; `n` a guess for ``"guesses"``."""
    parameters = problem.parameters
    if design == "shells":
        truth = truth_of(parameters)
        return ik.identify.shell_starts(parameters, n, center=truth, distances=DISTANCES, seed=SEED)
    if design == "bounds":
        return ik.identify.sobol_starts(parameters, n, seed=SEED)
    return np.repeat([ik.calibrate.named_start(x, parameters) for x in GUESSES], n, axis=0)


def swept(
    knee: str,
    problem: ik.LaxityResiduals,
    wanted: Part,
    options: argparse.Namespace,
    executor: ik.runs.Executor,
) -> ik.identify.SweepSearches:
    """The sweep of a part on a knee, from its store as far as it is there."""
    n = wanted.numbers[knee]
    n = max(1, n // 100) if options.quick else n
    starts = starts_of(problem, wanted.design, n)
    about = {
        "knee": records.knee_digest(problem.model.knee),
        "numbers": fingerprint(problem),
        "design": wanted.design,
        "distances": DISTANCES,
        "method": wanted.method,
        "starts": len(starts),
        "seed": SEED,
    }
    began = time.perf_counter()
    path = options.store / f"{knee}_{wanted.name}{'_quick' * options.quick}.sqlite"
    with ik.runs.open_work(path, about) as store:
        found = sweep(
            problem, starts, method=wanted.method, seed=SEED, executor=executor, store=store
        )
    records.say(f"{knee}: {found} ({time.perf_counter() - began:.0f} s)")
    return found


def described(problem: ik.LaxityResiduals) -> Row:
    """Names, truth and guesses of a knee, and room for its parts."""
    parameters = problem.parameters
    truth = truth_of(parameters)
    guesses = {x: ik.calibrate.named_start(x, parameters) for x in GUESSES}
    row: Row = rounded(
        {
            "parameters": parameters.names,
            "truth": truth,
            "guesses": guesses,
            "guess_distances": {
                x: ik.identify.distance(y, truth, parameters) for x, y in guesses.items()
            },
            "n_residuals": len(problem.residuals(truth)),
            "parts": {},
        }
    )
    return row


def part_row(problem: ik.LaxityResiduals, found: ik.identify.SweepSearches, wanted: Part) -> Row:
    """What the record keeps of a sweep."""
    truth = truth_of(problem.parameters)
    read = ik.identify.survey(problem, found, target=truth)
    summary = summary_of(read)
    away = ik.identify.distance(found.starts, truth, found.parameters)
    places = np.linspace(0, found.n - 1, min(found.n, N_QUANTILES)).astype(int)
    row: Row = {
        **{name: summary[name] for name in KEPT},
        "kind_to_polished": crossed(found),
        "predicted": shares_row(
            ik.identify.recovery(away, ~found.is_kind(ik.Outcome.START_FAILED))
        ),
        "recovered": {
            f"{end} within {within:g}": recovered_row(found, truth, away, within, end)
            for end in ("end", "polished")
            for within in WITHIN
        },
        "waterfall": {
            "number": places + 1,
            "end": np.sort(found.objectives)[places],
            "polished": np.sort(found.polished_objectives)[places],
        },
        "first": {
            "starts": found.starts[:N_DRAWN],
            "ends": found.ends[:N_DRAWN],
            "kinds": [ik.identify.OUTCOMES[k].value for k in found.kind_codes[:N_DRAWN]],
        },
        "busy_s": float(found.seconds.sum()),
        "longest_s": float(found.seconds.max()),
    }
    if wanted.design == "guesses":
        row["guesses"] = guess_rows(found, truth)
    checked: Row = rounded(row, 5)
    return checked


def crossed(found: ik.identify.SweepSearches) -> Row:
    """How many ends of each kind, by how their polishing ended."""
    rows: Row = {}
    for kind in ik.identify.OUTCOMES:
        of_kind = found.polished_codes[found.is_kind(kind)]
        if of_kind.size:
            rows[kind.value] = found.counts(of_kind)
    return rows


def recovered_row(
    found: ik.identify.SweepSearches,
    truth: ik.runs.Array,
    away: ik.runs.Array,
    within: float,
    end: str,
) -> Row:
    """Shares recovered by distance, and the radii for nine of ten and every second."""
    shares = ik.identify.recovery(
        away, ik.identify.is_recovered(found, truth, within=within, polished=end == "polished")
    )
    radii = {str(p): ik.identify.radius(shares, probability=p) for p in (0.9, 0.5)}
    return {
        **shares_row(shares),
        "radii": {p: [x.value, x.lower, x.upper] for p, x in radii.items()},
    }


def shares_row(found: ik.identify.Recovery) -> Row:
    """Distances and, at each, how many of how many with the limits of the share."""
    return {
        "distances": found.distances,
        "shares": [[x.count, x.n, x.lower, x.upper] for x in found.shares],
    }


def guess_rows(found: ik.identify.SweepSearches, truth: ik.runs.Array) -> Row:
    """For each guess: how its searches end, where polishing leads, errors as in Table 3."""
    groups = ik.identify.unit_groups(found.parameters)
    guess_of = np.repeat(GUESSES, found.n // len(GUESSES))
    rows: Row = {}
    for guess in GUESSES:
        chosen = np.flatnonzero(guess_of == guess)
        errors = np.abs(found.ends[chosen] - truth)
        rows[guess] = {
            "kinds": found.counts(found.kind_codes[chosen]),
            "polished": found.counts(found.polished_codes[chosen]),
            "error_kN": errors[:, groups == 0].mean(axis=1),
            "error_pct": errors[:, groups == 1].mean(axis=1),
            "polished_error": np.abs(found.polished[chosen] - truth).max(axis=1),
            "objective": found.objectives[chosen],
        }
    return rows


def cliff_row(
    knee: str, problem: ik.LaxityResiduals, options: argparse.Namespace, executor: ik.runs.Executor
) -> Row:
    """Cliffs on the straight paths from Sobol points of the bounds to the truth."""
    truth = truth_of(problem.parameters)
    n = 4 if options.quick else N_WAYS[knee]
    starts = ik.identify.sobol_starts(problem.parameters, n, seed=SEED)
    about = {
        "knee": records.knee_digest(problem.model.knee),
        "numbers": fingerprint(problem),
        "ways": n,
    }
    path = options.store / f"{knee}_cliffs{'_quick' * options.quick}.sqlite"
    with ik.runs.open_work(path, about) as store:
        found = ik.identify.map_cliffs(
            problem,
            starts,
            truth,
            lost_at=partial(trials_lost, problem.model),
            executor=executor,
            store=store,
        )
    row: Row = rounded(
        {
            "n_ways": n,
            "n_with_cliff": int(found.has_cliff.sum()),
            "share_lost": float(found.share_lost.mean()),
            "edge_distances": np.sort(found.edge_distances[found.has_cliff]),
            "start_distances": np.sort(ik.identify.distance(starts, truth, problem.parameters)),
            "trials_lost": dict(list(found.trials_lost.items())[:12]),
            "n_trials_lost": len(found.trials_lost),
        },
        4,
    )
    return row


def plane_rows(problem: ik.LaxityResiduals, n: int) -> Row:
    """Objectives over stiffness and reference strain of each ligament, the rest at the truth."""
    names = problem.parameters.names
    truth = truth_of(problem.parameters)
    rows: Row = {}
    for i, name in enumerate(names):
        owner, _, quantity = name.rpartition(".")
        if quantity == ik.model.STIFFNESS:
            pair = (i, problem.parameters.index(f"{owner}.{ik.model.STRAIN}"))
            values, objectives = ik.identify.plane(problem, truth, pair, n)
            rows[owner] = rounded({"values": values, "objectives": objectives}, 3)
    return rows


def fingerprint(problem: ik.LaxityResiduals) -> str:
    """Digest of what two short searches give: code that gives other numbers has another one."""
    start = ik.calibrate.named_start("IG4", problem.parameters)
    ends = [
        fit(problem, start, method=x, seed=SEED, budget=60) for x in ("least-squares", "complex")
    ]
    # Not the objective: that of a perfect fit is the rounding error of the residuals.
    return ik.runs.digest(str(rounded([[*x.theta, x.n_simulations] for x in ends], 8)).encode())


if __name__ == "__main__":
    main()
