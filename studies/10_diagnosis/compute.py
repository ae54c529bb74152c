"""Slow part of the study: blind cases made, diagnosed and scored.

Writes ``records/diagnosis.json``. Finished cases are kept in a store outside the checkout, so that
the same command resumes where it was stopped.
"""

import sys
import time
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from common import records
from common.records import Row, rounded, study_knee, write_record

import identknee as ik
from identknee.runs.schema import summary_of

KNEE = "reference"
SIGNALS = (12.0, 6.0)
# Two kinds each, so that one may be told from the other.
PAIRS = (
    ("anterolateral", "rig_compliance_VV"),
    ("posteromedial", "flexion_offset"),
    ("deep_mcl", "rig_compliance_IE"),
    ("meniscus", "femur_frame"),
    ("toe_strain", "moment_offset"),
    ("shank_gravity", "axis_misalignment"),
)
N_NULLS, N_UNLISTED = 20, 3
FIRST_SEED = 220_000
DIGITS = 5


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = records.parsed_options(__file__, "four cases", replicates=1)
    record = records.begun(options, [KNEE], signals=SIGNALS, pairs=PAIRS, first_seed=FIRST_SEED)
    tasks = quick_tasks() if options.quick else all_tasks(options.replicates)
    began = time.perf_counter()
    with records.working(options, inputs=record["head"]["inputs"], seed=FIRST_SEED) as kept:
        record["knees"][KNEE] = {"cases": kept(case_row, tasks, "cases")}
    record["seconds_last_run"] = rounded(time.perf_counter() - began, 3)
    write_record(options.record, record)


@cache
def reference() -> ik.Knee:
    """The knee of all cases."""
    return study_knee(KNEE)


def all_tasks(replicates: int) -> list[Row]:
    """Every case: what is hidden, how large, and its seed, which hangs on nothing else."""
    kinds: list[Row] = [task("nothing hidden", (), None) for _ in range(N_NULLS)]
    kinds += [task("one", (name,), signal) for signal, name in product(SIGNALS, ik.blind.LISTED)]
    kinds += [task("two", pair, SIGNALS[0]) for pair in PAIRS]
    kinds += [
        task("unlisted", (name,), SIGNALS[0])
        for name, _ in product(ik.blind.UNLISTED, range(N_UNLISTED))
    ]
    # Replicate after replicate, so that more of them go on where fewer ended.
    return [
        {**kind, "seed": FIRST_SEED + 1000 * r + i}
        for r in range(replicates)
        for i, kind in enumerate(kinds)
    ]


def quick_tasks() -> list[Row]:
    """One case of every series."""
    whole = all_tasks(1)
    return list({x["series"]: x for x in reversed(whole)}.values())


def task(series: str, effects: tuple[str, ...], signal: float | None) -> Row:
    """A case to be made."""
    return {"series": series, "effects": list(effects), "wanted": signal}


def case_row(case: Mapping[str, Any]) -> Row:
    """What came of a case; ``error`` where no such case could be drawn."""
    knee, row = reference(), dict(case)
    try:
        blind = ik.blind.blind_case(
            knee, seed=case["seed"], effect=case["effects"] or None, signal=case["wanted"]
        )
    except ValueError as error:
        return {**row, "error": str(error)}
    began = time.perf_counter()
    answer = ik.diagnose(knee, blind.laxity)
    seconds = time.perf_counter() - began
    summary = summary_of(answer)
    judged = ik.blind.score(blind.truth, summary)
    row |= {
        "signal": blind.truth.signal,
        "is_largest": blind.truth.is_largest,
        "verdict": judged.verdict,
        "causes": [x["name"] for x in summary["causes"]],
        "group": summary["group"],
        "correct": judged.correct,
        "wrong": judged.wrong,
        "in_group": judged.in_group,
        "amplitudes": amplitudes(blind.truth, summary["causes"]),
        "stiffness_error_kN": judged.stiffness_error_kN,
        "strain_error_pct": judged.strain_error_pct,
        "coverage": [judged.covered_before, judged.covered_after],
        "line": [judged.line_offset_mm, judged.line_angle_deg],
        "seconds": seconds,
    }
    return dict(rounded(row, DIGITS))


def amplitudes(truth: ik.blind.Truth, causes: Sequence[Row]) -> list[Row]:
    """True and found size of each true cause named; a vector by its length."""
    rows = []
    for cause in causes:
        true = truth.amplitudes.get(cause["name"], {})
        shared = [true[name][0] for name in cause["parameters"] if name in true]
        if not shared:
            continue
        size = true[cause["parameter"]][0] if cause["parameter"] in true else np.linalg.norm(shared)
        rows.append(
            {
                "name": cause["name"],
                "true": float(size),
                "found": cause["amplitude"],
                "ci95": cause["ci95"],
                "unit": cause["unit"],
            }
        )
    return rows


if __name__ == "__main__":
    main()
