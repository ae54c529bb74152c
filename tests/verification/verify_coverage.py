"""Coverage of 95 % profile intervals in simulated data with a known truth.

An interval covers the truth if the profile deviance there is no more than the threshold above its
minimum, so that one free fit and one fit for each parameter decide, and no interval is searched
for. Where the chi-square threshold fails, one bootstrap for that design gives others: data
simulated at the fit to one data set of another seed, and the 95 % quantile of the rises in them.
"""

import argparse
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from coverage_replicates import DESIGNS, Design, design_model, noisy_problem, replicate
from requirement_rows import Measure, Row
from scipy.stats import binomtest, chi2
from work_store import work_store

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import Evaluator, ParameterQuantity
from identknee.identify.profile.result import bootstrap_statistics, resimulated
from identknee.runs.declare import Array
from identknee.runs.executors import process_pool
from identknee.runs.store import Store, resumable_map
from identknee.verbs.verb import knee_digest

LEVEL = 0.95
REPLICATES = {"reference": 1000, "lenhart2015_stable": 200}
BOOTSTRAP = 1000
CELLS = 24
# Every so many replicates are fitted from other starts too.
LOOKED_AT = 10
# Of the deviance, beside a threshold of 3.84.
NEGLIGIBLE = 0.01
WORKERS = 2
# First words of the seeds of the data sets, so that no two purposes share one.
DATA, OTHER_DATA = range(2)


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Coverage of every parameter in one design, with its Clopper-Pearson interval."""

    names: tuple[str, ...]
    covered: Array
    n: int

    @property
    def intervals(self) -> list[tuple[float, float]]:
        level = 1.0 - 0.05 / CELLS
        found = [binomtest(int(k), self.n).proportion_ci(level, "exact") for k in self.covered]
        return [(float(x.low), float(x.high)) for x in found]

    @property
    def outside(self) -> list[str]:
        pairs = zip(self.names, self.intervals, strict=True)
        return [name for name, (low, high) in pairs if not low <= LEVEL <= high]

    def measures(self, where: str, *, is_judged: bool) -> list[Measure]:
        shares = 100.0 * self.covered / self.n
        cells = [
            Measure(
                what=f"{where}, {name}",
                value=float(share),
                unit="%",
                low=100.0 * low,
                high=100.0 * high,
                count=self.n,
                interval="Clopper-Pearson at level 1 - 0.05/24",
            )
            for name, share, (low, high) in zip(self.names, shares, self.intervals, strict=True)
        ]
        mean = float(shares.mean())
        return [
            *cells,
            Measure(
                what=f"{where}, cells without 95 % in their interval",
                value=len(self.outside),
                unit="",
                bar=0 if is_judged else None,
                count=len(cells),
            ),
            Measure(
                what=f"{where}, mean {mean:.2f} %, away from 95",
                value=abs(mean - 95.0),
                unit="%",
                bar=1.0 if is_judged else None,
            ),
        ]


def measure(options: argparse.Namespace) -> Row:
    """Coverage in three designs for two knees, with other thresholds where the plain one fails."""
    measures: list[Measure] = []
    notes: list[str] = []
    about = {
        "digests": {knee: knee_digest(design_model(knee, DESIGNS[0]).knee) for knee in REPLICATES},
        "replicates": REPLICATES,
    }
    with work_store("coverage", about) as store:
        for knee in REPLICATES:
            for design in DESIGNS:
                found, said = _design(knee, design, store)
                measures += found
                notes += said
    return Row(
        line="coverage of 95 % profile intervals, >= 500 replicates on reference (a fifth on "
        "lenhart2015_stable), 8 parameters, 3 designs: Clopper-Pearson at level 1 - 0.05/24 "
        "contains 95 % in all 24 cells, mean over parameters 94-96 % per design",
        measures=measures,
        notes=notes,
    )


def _design(knee: str, design: Design, store: Store) -> tuple[list[Measure], list[str]]:
    where = f"{knee}, {design.name}"
    names = design_model(knee, design).parameters.names
    # A fifth of the replicates is for seeing the same on another knee, too few to judge by.
    is_judged = knee == "reference"
    truth = tuple(design_model(knee, design).parameters.center.tolist())
    replicates = _replicates(knee, design, truth, store)
    rises = np.array([x["rises"] for x in replicates])
    plain = _cells(names, rises, np.full(len(names), chi2.ppf(LEVEL, 1)))
    mean = 100.0 * plain.covered.mean() / plain.n
    fails = bool(plain.outside) or (is_judged and not 94.0 <= mean <= 96.0)
    measures = plain.measures(where, is_judged=is_judged and not fails)
    notes = _notes(where, replicates)
    if fails:
        thresholds = _bootstrapped(knee, design, truth)
        calibrated = _cells(names, rises, thresholds)
        measures += calibrated.measures(f"{where}, bootstrap thresholds", is_judged=is_judged)
        which = ", ".join(plain.outside) or "the mean"
        values = ", ".join(f"{n} {t:.2f}" for n, t in zip(names, thresholds, strict=True))
        notes.append(f"{where}: the plain threshold of 3.84 fails for {which}; instead {values}")
    looked = [x["lower_elsewhere"] for x in replicates if x["lower_elsewhere"] is not None]
    measures.append(
        Measure(
            what=f"{where}, minima lower by more than {NEGLIGIBLE} found from other starts",
            value=sum(x > NEGLIGIBLE for x in looked),
            unit="",
            bar=0,
            count=len(looked),
        )
    )
    return measures, notes


def _replicates(
    knee: str, design: Design, truth: tuple[float, ...], store: Store
) -> list[dict[str, Any]]:
    place = DESIGNS.index(design)
    tasks = [
        (knee, design, truth, (DATA, place, i), i % LOOKED_AT == 0) for i in range(REPLICATES[knee])
    ]
    with process_pool(WORKERS) as executor:
        return resumable_map(
            replicate,
            tasks,
            executor=executor,
            store=store,
            name=f"{knee}/{design.name}",
            description=f"{knee}, {design.name}",
        )


def _bootstrapped(knee: str, design: Design, truth: tuple[float, ...]) -> Array:
    """Threshold of each parameter from data simulated at the fit to another data set."""
    place = DESIGNS.index(design)
    other = noisy_problem(knee, design, truth, (OTHER_DATA, place))
    fitted = minimise(Evaluator(other), np.array(truth)).evaluation.theta
    parameters = other.parameters
    with (
        work_store(f"bootstrap_{knee}_{place}", {"theta": fitted, "n": BOOTSTRAP}) as store,
        process_pool(WORKERS) as executor,
    ):
        found = bootstrap_statistics(
            partial(resimulated, other, fitted),
            fitted,
            [ParameterQuantity(parameters=parameters, name=name) for name in parameters.names],
            n=BOOTSTRAP,
            seed=OTHER_DATA,
            executor=executor,
            store=store,
        )
    return np.asarray(found.thresholds(LEVEL)[:, 0])


def _cells(names: tuple[str, ...], rises: Array, thresholds: Array) -> Cells:
    return Cells(names=names, covered=(rises <= thresholds).sum(axis=0), n=len(rises))


def _notes(where: str, replicates: list[dict[str, Any]]) -> list[str]:
    outcomes = [outcome for x in replicates for outcome in x["outcomes"]]
    counts = ", ".join(f"{outcomes.count(x)} {x}" for x in sorted(set(outcomes)))
    simulations = np.mean([x["n_simulations"] for x in replicates])
    return [f"{where}: {counts}; {simulations:.0f} simulations a replicate"]
