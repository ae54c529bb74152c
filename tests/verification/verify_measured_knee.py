"""The measured knee: the verbs end, and their best fits are one."""

import argparse
import time

import numpy as np
from requirement_rows import Measure, Row

import identknee as ik

KNEES = ("s192803", "s192803_bundles")
HOW = {
    "uncertain": "registration=4deg,registration=4mm,insertions=4mm",
    "noise": "1mm,1.5deg",
}
N_STARTS, BLOCKS = 200, 256
MINUTES = 10.0


def measure(options: argparse.Namespace) -> Row:
    """Deviance of the best fit and time by verb, ends of a sweep, and groups with an index."""
    how = {**HOW, "workers": options.workers}
    measures, notes = [], []
    for knee in KNEES:
        deviances: dict[str, float] = {}
        minutes: dict[str, float] = {}
        began = time.perf_counter()

        def ended(verb: str, taken: dict[str, float] = minutes) -> None:
            nonlocal began
            taken[verb] = (time.perf_counter() - began) / 60.0
            began = time.perf_counter()

        fitted = ik.fit(knee, "s192803", **how)
        ended("fit")
        deviances["fit"] = 2.0 * fitted.objective
        profiles = ik.profile(knee, "s192803", **how)
        ended("profile")
        deviances["profile"] = profiles.deviance
        swept = ik.sweep(knee, "s192803", n_starts=N_STARTS, paths=0, **how)
        ended("sweep")
        searches = swept.searches
        best = searches.lowest_objective if swept.best is None else swept.best.objective
        deviances["sweep"] = 2.0 * best
        analysed = ik.sensitivity(knee, "s192803", samples=BLOCKS, **how)
        ended("sensitivity")
        total = analysed.analysis.indices["ST"].final[:-1]
        counts = searches.polished_outcomes
        n_named = counts.get("minimum", 0) + counts.get("cliff", 0)
        apart = max(deviances.values()) - min(deviances.values())
        measures += [
            Measure(what=f"{knee}: deviances of verbs apart by", value=apart, unit="1", bar=0.1),
            Measure(
                what=f"{knee}: starts of a sweep that fail",
                value=float(searches.outcomes.get("start_failed", 0)),
                unit="starts",
                bar=0.0,
            ),
            Measure(
                what=f"{knee}: ends at a minimum or an edge",
                value=n_named / searches.n,
                unit="1",
                bar=0.9,
                at_least=True,
            ),
            Measure(
                what=f"{knee}: groups of outputs with indices",
                value=float(np.isfinite(total).all(axis=1).mean()),
                unit="1",
                bar=0.9,
                at_least=True,
            ),
            *(
                Measure(what=f"{knee}: {verb}", value=value, unit="min", bar=MINUTES)
                for verb, value in minutes.items()
            ),
        ]
        said = ", ".join(f"{verb} {value:.3f}" for verb, value in deviances.items())
        notes.append(
            f"{knee}: deviances {said}; lowest end of the sweep itself "
            f"{2.0 * searches.lowest_objective:.3f}; polished ends {dict(counts)}; half-widths of "
            f"indices up to {analysed.analysis.worst_half_width:.2g}"
        )
    return Row(
        line="verbs of s192803 and s192803_bundles, same options: deviance at their best fit "
        "within 0.1; a sweep of 200 starts without a failure, 90 % at a minimum or a named edge; "
        "sensitivity with indices for 90 % of the predictions; each within 10 min on 2 cores",
        measures=measures,
        notes=notes,
    )
