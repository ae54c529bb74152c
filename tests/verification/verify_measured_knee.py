"""The measured knee: every verb ends within minutes, and the best fits of all are one.

Each verb runs alone, in a folder of its own. `sample` and `diagnose` weigh probabilities and keep
the priors of ligament parameters; their fits are held against `fit --priors`.
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from kept_outcomes import KeptOutcomes
from requirement_rows import Measure, Row

import identknee as ik

KEPT = KeptOutcomes("measured_knee")
KNEES = ("s192803", "s192803_bundles")
HOW = {
    "uncertain": "registration=4deg,registration=4mm,insertions=4mm",
    "noise": "1mm,1.5deg",
}
N_STARTS, BLOCKS = 200, 256
MINUTES, APART = 10.0, 0.1
VERBS: Mapping[str, Callable[..., Any]] = {
    "fit": ik.fit,
    "information": ik.information,
    "profile": ik.profile,
    "design": ik.design,
    "sensitivity": ik.sensitivity,
    "sweep": ik.sweep,
    "fit --priors": ik.fit,
    "diagnose": ik.diagnose,
    "equivalents": ik.equivalents,
    "sample": ik.sample,
}
OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "sweep": {"n_starts": N_STARTS, "paths": 0},
    "sensitivity": {"samples": BLOCKS},
    "fit --priors": {"priors": True},
}
# A sweep of 200 starts and a sample to its gate are asked for more than the defaults.
NOT_TIMED = ("sweep", "sample")
# What takes longest, so that an interrupted run has all else.
LAST = (("s192803", "sweep"), ("s192803_bundles", "sweep"), ("s192803_bundles", "sample"))
# Verbs that are asked with the priors of ligament parameters.
WITH_PRIORS = ("fit --priors", "sample")
# What has no best fit of the data in units of the noise that was stated.
WITHOUT_FIT = ("sensitivity", "diagnose")


def parts(options: argparse.Namespace) -> Iterator[Row]:
    """Deviance of the best fit and time by verb, ends of a sweep, and groups with an index."""
    tasks = sorted(((knee, verb) for verb in VERBS for knee in KNEES), key=lambda x: x in LAST)
    if known := _known():
        yield _row(known)
    for task in tasks:
        if task not in _known():
            KEPT.keep(" ".join(task), _outcome(*task, options.workers))
            yield _row(_known())


def _known() -> dict[tuple[str, str], dict[str, Any]]:
    return {(x["knee"], x["verb"]): x for x in KEPT.known().values()}


def _outcome(knee: str, verb: str, workers: int) -> dict[str, Any]:
    began, spent = time.perf_counter(), _processor_seconds()
    how = {**HOW, **OPTIONS.get(verb, {}), "workers": workers}
    answer = VERBS[verb](knee, "s192803", **how)
    found: dict[str, Any] = {
        "knee": knee,
        "verb": verb,
        "minutes": (time.perf_counter() - began) / 60.0,
        "processor_s": _processor_seconds() - spent,
        "deviance": sum(x.deviance for x in answer.evidence) or None,
    }
    if verb == "sweep":
        searches = answer.searches
        found |= {
            "ends": dict(searches.polished_outcomes),
            "n": searches.n,
            "failed": searches.outcomes.get("start_failed", 0),
            "lowest": 2.0 * searches.lowest_objective,
        }
    if verb == "sensitivity":
        total = answer.analysis.indices["ST"].final[:-1]
        found |= {
            "with_index": float(np.isfinite(total).all(axis=1).mean()),
            "half_width": float(answer.analysis.worst_half_width),
        }
    if verb == "profile":
        found |= {"profiles": {k: _profile(x) for k, x in answer.parameters.items()}}
    if verb == "sample":
        found |= {"outcome": answer.outcome.value, "gate": answer.gate, "n": answer.n_simulations}
    return found


def _processor_seconds() -> float:
    """Processor time of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def _profile(found: Any) -> dict[str, Any]:
    return {"verdict": found.verdict.value, "ends": [found.lower, found.upper]}


def _row(known: Mapping[tuple[str, str], Mapping[str, Any]]) -> Row:
    measures: list[Measure] = []
    notes = []
    for knee in KNEES:
        own = {verb: x for (of, verb), x in known.items() if of == knee}
        for name, with_priors in (("data alone", False), ("with priors", True)):
            values = [
                x["deviance"]
                for verb, x in own.items()
                if verb not in WITHOUT_FIT and (verb in WITH_PRIORS) is with_priors
                # A sample that could not begin has none; its outcome is among the notes.
                if x["deviance"] is not None
            ]
            measures.append(
                Measure(
                    what=f"{knee}, {name}: deviances of verbs apart by",
                    value=max(values, default=np.nan) - min(values, default=np.nan),
                    unit="1",
                    bar=APART,
                    count=len(values),
                )
            )
        measures += _of_sweep(knee, own["sweep"]) if "sweep" in own else []
        if "sensitivity" in own:
            measures.append(
                Measure(
                    what=f"{knee}: groups of outputs with indices",
                    value=own["sensitivity"]["with_index"],
                    unit="1",
                    bar=0.9,
                    at_least=True,
                )
            )
        measures += [
            Measure(
                what=f"{knee}: {verb}",
                value=x["minutes"],
                unit="min",
                bar=None if verb in NOT_TIMED else MINUTES,
            )
            for verb, x in own.items()
        ]
        spent = ", ".join(f"{k} {x['processor_s']:.0f}" for k, x in own.items())
        said = ", ".join(f"{k} {x['deviance']:.3f}" for k, x in own.items() if x["deviance"])
        notes.append(f"{knee}: deviances {said}; processor time {spent} s")
        if "sample" in own:
            x = own["sample"]
            notes.append(f"{knee}: sample {x['outcome']} after {x['n']} simulations, {x['gate']}")
        missing = [verb for verb in VERBS if verb not in own]
        notes += [f"{knee}: not finished: {', '.join(missing)}"] if missing else []
    return Row(
        line="verbs of s192803 and s192803_bundles, same options: deviance at their best fit "
        "within 0.1; a sweep of 200 starts without a failure, 90 % at a minimum or a named edge; "
        "sensitivity with indices for 90 % of the predictions; each within 10 min on 2 cores",
        measures=measures,
        notes=notes,
    )


def _of_sweep(knee: str, sweep: Mapping[str, Any]) -> list[Measure]:
    ends = sweep["ends"]
    named = (ends.get("minimum", 0) + ends.get("cliff", 0)) / sweep["n"]
    return [
        Measure(
            what=f"{knee}: starts of a sweep that fail",
            value=float(sweep["failed"]),
            unit="starts",
            bar=0.0,
        ),
        Measure(
            what=f"{knee}: ends at a minimum or an edge",
            value=named,
            unit="1",
            bar=0.9,
            at_least=True,
        ),
    ]
