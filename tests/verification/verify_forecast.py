"""Widths that `design` predicts after a cut or a measured force, against the widths got with it."""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from requirement_rows import Measure, Row

import identknee as ik
from identknee.identify.design_criteria import Step
from identknee.laxity.forces import MeasuredForces
from identknee.laxity.protocol import concatenate
from identknee.model.candidate_laxity import CONTACT_SD, TENSION_SD
from identknee.model.contact_loads import contact_values
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import structure_values

KNEES, NOISE, EACH = ("reference", "lenhart2015_stable"), "0.5mm,0.5deg", 2
PROTOCOL, COORDINATE_SD, BAR = "seed63", 0.5, 0.2


def measure(options: argparse.Namespace) -> Row:
    """Relative differences of widths, by knee and kind of step."""
    measures, notes = [], []
    for name in KNEES:
        knee = ik.example(name)
        answer = ik.design(knee, protocol=PROTOCOL, noise=NOISE, workers=options.workers)
        choice = answer.choice
        found: dict[str, list[float]] = {}
        for step in _best_steps(choice):
            profiles = ik.profile(knee, _with_step(knee, answer, step), workers=options.workers)
            place = choice.steps.index(step)
            by_step = choice.narrowing.now * (1.0 - choice.narrowing.by_step[place])
            for target, width in zip(choice.targets, by_step, strict=True):
                own = profiles.parameters[target]
                if own.lower is not None and own.upper is not None:
                    found.setdefault(step.kind, []).append(width / (own.upper - own.lower) - 1.0)
            notes.append(f"{name}: {step.name}")
        measures += [
            Measure(
                what=f"{name}, {kind}: largest difference of {len(x)} widths",
                value=float(np.abs(x).max()),
                unit="1",
                bar=BAR,
                count=len(x),
            )
            for kind, x in found.items()
        ]
    return Row(
        line="`design`'s forecast of a width after a cut or a force, against the width got: within "
        "20 %",
        measures=measures,
        notes=notes,
    )


def _best_steps(choice: Any) -> Iterator[Step]:
    """The most telling steps of each kind."""
    for kind in ("cut", "force", "contact"):
        names = [x["name"] for x in choice.ranking if x["kind"] == kind][:EACH]
        for name in names:
            yield next(x for x in choice.steps if x.name == name)


def _with_step(knee: ik.Knee, answer: Any, step: Step) -> ik.Laxity:
    """The planned laxity without noise, and what the step measures."""
    base = ik.load_protocol(PROTOCOL)
    if step.kind == "cut":
        place = answer.choice.names.index(step.trial)
        again = answer.candidates.select([place])
        cut = replace(again, trials=(step.name,), state=(f"cut: {step.structure}",))
        base = concatenate([base, cut])
    model = LaxityModel(knee=knee, protocol=base)
    prediction = model.predict(model.parameters.start)
    laxity = replace(model.simulate(model.parameters.start), sd=np.full((base.n, 5), COORDINATE_SD))
    if step.kind == "cut":
        return laxity
    trial = base.trials.index(step.trial)
    names: tuple[str, ...]
    if step.kind == "force":
        names, sd = (f"{step.structure}.tension_N",), TENSION_SD
        values = structure_values(model, prediction, step.structure)[0][trial : trial + 1]
    else:
        names, sd = ("contact.medial_N", "contact.lateral_N"), CONTACT_SD
        values = contact_values(prediction)[trial, :, 0]
    all_values, all_sd = (np.full((base.n, len(names)), np.nan) for _ in range(2))
    all_values[trial], all_sd[trial] = values, sd
    return replace(laxity, forces=MeasuredForces(names=names, values=all_values, sd=all_sd))
