"""Intervals of four verbs for the same question: none may exclude all that another allows.

Each pair of profile, posterior, diagnosis and local approximation counts for every parameter. The
sample and the diagnosis of the measured knee use priors of ligament parameters, which the others do
not, and the diagnosis centres them elsewhere. Answers to different questions may lie apart, if the
report names in what they differ.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from kept_outcomes import KeptOutcomes
from requirement_rows import Measure, Row

import identknee as ik
from identknee.report.overview import Relation, relation
from identknee.report.presenter import Source, presenter_of

KEPT = KeptOutcomes("interval_pairs")
KNEES = ("reference", "lenhart2015_stable")
N_OF_EACH, MEASURED = 2, "s192803"
# One data set of each simulated knee has uncertain insertions.
UNCERTAIN = {0: "insertions=2mm"}
MEASURED_HOW = {
    "uncertain": "registration=4deg,registration=4mm,insertions=4mm",
    "noise": "1mm,1.5deg",
}
LOG_SD, STRAIN_SD = 0.2, 1.0
LINE = (
    "pairs of intervals (profile, sample, diagnose, information) that do not overlap: 0, or the "
    "limiting term named"
)


def measure(options: argparse.Namespace) -> Row:
    """How many pairs of intervals have no value in common."""
    tasks: dict[str, Any] = {
        f"{knee}:{i}": partial(_simulated, knee, i) for knee in KNEES for i in range(N_OF_EACH)
    }
    tasks = {MEASURED: partial(_pairs, MEASURED, MEASURED, MEASURED_HOW), **tasks}
    KEPT.compute(tasks, options.workers)
    return _row({key: KEPT.known()[key] for key in tasks})


def _simulated(name: str, number: int) -> dict[str, Any]:
    """Pairs of a knee drawn around the subject, under the paper's trials with noise."""
    knee, generator = ik.example(name), np.random.default_rng([number, *name.encode()])
    truth = knee.with_ligaments(
        [
            replace(
                x,
                stiffness_kN=x.stiffness_kN * np.exp(LOG_SD * generator.standard_normal()),
                reference_strain_pct=x.reference_strain_pct
                + STRAIN_SD * generator.standard_normal(),
            )
            for x in knee.ligaments
        ]
    )
    made = ik.simulate(truth, "seed63").laxity
    laxity = ik.add_noise(made, sd_mm=0.5, sd_deg=0.5, seed=number)
    how = {"uncertain": UNCERTAIN[number]} if number in UNCERTAIN else {}
    return _pairs(knee, laxity, {"noise": "0.5mm,0.5deg", **how})


def _pairs(knee: Any, laxity: Any, how: dict[str, str]) -> dict[str, Any]:
    """Which pairs of intervals of four verbs lie apart, and how many pairs there are."""
    verbs: tuple[Callable[..., Any], ...] = (
        ik.profile,
        ik.sample,
        ik.diagnose,
        ik.information,
    )
    answers = [verb(knee, laxity, **how) for verb in verbs]
    ranges: dict[str, list[Any]] = {}
    for answer in answers:
        for name, x in presenter_of(answer).ranges(answer):
            if "@" not in name and x.source is not Source.CAUSE:
                ranges.setdefault(name, []).append((x, answer.question))
    pairs = [(name, *pair) for name, own in ranges.items() for pair in combinations(own, 2)]
    apart = [
        {
            "pair": f"{name}: {a.source.value} {_words(a)}, {b.source.value} {_words(b)}",
            "because": list(asked.differences(other)),
        }
        for name, (a, asked), (b, other) in pairs
        if relation(a, b) is Relation.APART
    ]
    sample = answers[1].outcome.value
    return {"n": len(pairs), "apart": apart, "sample": sample}


def _words(of: Any) -> str:
    low, high = ("open" if x is None else f"{x:.4g}" for x in (of.low, of.high))
    return f"{low} to {high}"


def _row(outcomes: dict[str, Any]) -> Row:
    apart = [
        (f"{key}: {x['pair']}", x["because"]) for key, own in outcomes.items() for x in own["apart"]
    ]
    n = sum(x["n"] for x in outcomes.values())
    samples = ", ".join(f"{key} {x['sample']}" for key, x in outcomes.items())
    return Row(
        line=LINE,
        measures=[
            Measure(
                what="pairs without a common value, and no difference of the questions named",
                value=float(sum(not because for _, because in apart)),
                unit="pairs",
                bar=0.0,
                count=n,
            ),
            Measure(
                what="pairs without a common value", value=float(len(apart)), unit="pairs", count=n
            ),
        ],
        notes=[
            f"samples: {samples}",
            *(f"{pair}; {' and '.join(because) or 'the same question'}" for pair, because in apart),
        ],
    )
