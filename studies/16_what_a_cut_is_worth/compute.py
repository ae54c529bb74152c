"""Slow part of the study: what each way to spend trials tells, and what forces of the ACL do.

Intervals of every parameter and of forces after each plan on three knees with a capsule, one of
them of bundles; slack lengths of 18 ligaments from laxity and ACL forces; and a measured knee, with
what its laboratory could have done.
Writes ``records/what_a_cut_is_worth.json``. Finished cases are kept in a store outside the
checkout, so that the same command resumes where it was stopped.
"""

import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import laboratory
import numpy as np
import slack_lengths
from common.records import (
    BUNDLES,
    Kept,
    Row,
    begun,
    parsed_options,
    rounded,
    say,
    study_knee,
    working,
    write_record,
)

import identknee as ik
from identknee.laxity.forces import MeasuredForces
from identknee.laxity.protocol import concatenate
from identknee.model.contact_loads import contact_values
from identknee.model.line_loads import structure_values
from identknee.subject.knee import Uncertainty

MEASURED = "s192803"
# The structures of each knee whose tension is measured or asked for.
KNEES = {
    "reference": ("ACL", "PCL", "LCL", "MCL"),
    "lenhart2015_stable": ("ACL", "PCL", "LCL", "MCL"),
    "s192803_bundles": ("ACL", "PCL", "lateral", "medial"),
}
# The bundles of a structure that a plan cuts, where a knee has bundles.
CUT_BUNDLES = {"s192803_bundles": {"MCL": "MCLa, MCLm, MCLp"}}
PROTOCOL, NOISE, INSERTIONS_MM = "table2", 0.5, 2.0
TENSION_SD, CONTACT_SD = 5.0, 20.0
# States in which the protocol is done, and what is measured beside the pose in the last of them.
PLANS: dict[str, tuple[tuple[str, ...], str]] = {
    "intact": (("intact",) * 3, ""),
    "ACL cut": (("intact", "intact", "cut: ACL"), ""),
    "ACL, then MCL cut": (("intact", "cut: ACL", "cut: ACL, MCL"), ""),
    "in-situ forces": (("intact",) * 3, "tension"),
    "contact forces": (("intact",) * 3, "contact"),
}
DIGITS = 5


def main() -> None:
    """Compute what the store does not hold yet and write the record."""
    options = parsed_options(__file__, "one knee, two plans")
    names = list(KNEES)[:1] if options.quick else list(KNEES)
    plans = list(PLANS)[:2] if options.quick else list(PLANS)
    seeds = range(0 if options.quick else slack_lengths.N_REPLICATES)
    record = begun(
        options,
        names if options.quick else (*names, BUNDLES, MEASURED),
        protocol=PROTOCOL,
        noise=NOISE,
        insertions_mm=INSERTIONS_MM,
        tension_sd_N=TENSION_SD,
        contact_sd_N=CONTACT_SD,
        seeds=list(seeds),
    )
    tasks = [{"knee": name, "plan": plan} for name in names for plan in plans]
    began = time.perf_counter()
    known = {"inputs": record["head"]["inputs"], "plans": {x: list(PLANS[x][0]) for x in plans}}
    with working(options, **known) as kept:
        rows = kept(partial(plan_row), tasks, "plans")
        for name in names:
            own = [x for x, task in zip(rows, tasks, strict=True) if task["knee"] == name]
            record["knees"][name] = {"plans": own}
        if not options.quick:
            calibrations = [{"seed": i, "way": x} for i in seeds for x in slack_lengths.WAYS]
            found = kept(slack_lengths.calibrated, calibrations, "calibrations")
            record["knees"][BUNDLES] = {"calibrations": found}
            record["knees"][MEASURED] = measured_knee(kept)
    record["seconds_last_run"] = rounded(time.perf_counter() - began, 3)
    write_record(options.record, record)
    say(f"written: {options.record.name}")


def measured_knee(kept: Kept) -> Row:
    """What the laboratory of the measured knee could have done, and what `design` would advise."""
    (found,) = kept(laboratory.found_knee, [{"knee": MEASURED}], "knee")
    theta = found["theta"]
    plans = [{"plan": x, "theta": theta} for x in laboratory.PLANS]
    part: Row = {"found": found, "plans": kept(laboratory.plan_row, plans, "laboratory")}
    (part["advice"],) = kept(laboratory.advice_row, [{"theta": theta}], "advice")
    steps = [{"step": x, "theta": theta} for x in ({}, *part["advice"]["steps"])]
    part["steps"] = kept(laboratory.step_row, steps, "steps")
    return part


def plan_row(task: Row, parameters: list[str] | None = None) -> Row:
    """Intervals of all parameters, or of some, and of largest forces, after one plan on a knee."""
    name, (states, measured) = task["knee"], PLANS[task["plan"]]
    knee = study_subject(name)
    laxity = planned_laxity(knee, KNEES[name], states_of(name, states), measured)
    intact = planned_laxity(knee, KNEES[name], ("intact",), "tension")
    assert intact.forces is not None
    strongest = np.argmax(np.asarray(intact.forces.values), axis=0)
    asked = [
        f"{x}.tension_N@{intact.protocol.trials[i]}"
        for x, i in zip(KNEES[name], strongest.tolist(), strict=True)
    ]
    found = laboratory.intervals(knee, laxity, asked, parameters)
    row: Row = rounded({"plan": task["plan"], "n_trials": laxity.n, **found}, DIGITS)
    return row


def states_of(name: str, states: tuple[str, ...]) -> tuple[str, ...]:
    """The states of a plan, their cuts in the words of a knee."""
    for structure, bundles in CUT_BUNDLES.get(name, {}).items():
        states = tuple(x.replace(structure, bundles) for x in states)
    return states


def study_subject(name: str) -> ik.Knee:
    """A knee with a capsule, all other insertions known to 2 mm."""
    knee = study_knee(name)
    spreads = {x.name: {"femur": INSERTIONS_MM, "tibia": INSERTIONS_MM} for x in knee.ligaments}
    return ik.subject.with_capsule(knee).with_uncertainty(Uncertainty(insertions_mm=spreads))


def planned_laxity(
    knee: ik.Knee, structures: tuple[str, ...], states: tuple[str, ...], measured: str
) -> ik.Laxity:
    """What a plan would measure of the knee, without noise; trials that do not hold are missing."""
    base = ik.load_protocol(PROTOCOL)
    protocol = concatenate(
        [
            replace(base, trials=tuple(f"{x}_{k}" for x in base.trials), state=(state,) * base.n)
            for k, state in enumerate(states)
        ],
        name="plan",
    )
    model = ik.LaxityModel(knee=knee, protocol=protocol)
    prediction = model.predict(model.parameters.start)
    laxity = replace(model.simulate(model.parameters.start), sd=np.full((protocol.n, 5), NOISE))
    if measured == "tension":
        forces = {f"{x}.tension_N": structure_values(model, prediction, x)[0] for x in structures}
        laxity = replace(laxity, forces=_in_last(forces, base.n, TENSION_SD))
    elif measured == "contact":
        values = contact_values(prediction)[:, :, 0].T
        forces = dict(zip(("contact.medial_N", "contact.lateral_N"), values, strict=True))
        laxity = replace(laxity, forces=_in_last(forces, base.n, CONTACT_SD))
    return laxity.select(np.flatnonzero(laxity.is_measured.all(axis=1)))


def _in_last(forces: dict[str, ik.runs.Array], n: int, sd: float) -> MeasuredForces:
    """Forces that are measured in the last n trials alone."""
    values = np.column_stack(list(forces.values()))
    values[:-n] = np.nan
    return MeasuredForces(
        names=tuple(forces), values=values, sd=np.where(np.isnan(values), np.nan, sd)
    )


if __name__ == "__main__":
    main()
