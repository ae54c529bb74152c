"""Blind cases of a knee whose insertions are wrong and said to be, diagnosed."""

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from blind_diagnoses import judged
from knees import knee

from identknee.blind.case import BlindCase, blind_case
from identknee.blind.conditions import Conditions
from identknee.diagnosis.fitting import best_fit_from
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.score import detection_power
from identknee.diagnosis.verdict import Verdict
from identknee.runs.declare import Array
from identknee.subject.knee import Uncertainty


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertainCase:
    """A blind case of a knee with insertions wrong by ``actual_mm``, stated to ``stated_mm``."""

    subject: str
    effect: str
    signal: float | None
    seed: int
    actual_mm: float
    stated_mm: float


def uncertain_outcome(task: UncertainCase) -> dict[str, Any]:
    """What came of a task; ``error`` where no case could be drawn.

    ``beyond`` is the root of the deviance that the model leaves of the data without noise,
    insertions within their prior: the signal that the stated errors leave. ``power`` is what the
    diagnosis claims for an effect of the true size.
    """
    given = knee(task.subject)
    effects = [task.effect] if task.effect else []
    about: dict[str, Any] = {"effects": effects, "seed": task.seed}
    try:
        case = blind_case(
            given,
            seed=task.seed,
            effect=effects or None,
            signal=task.signal,
            conditions=Conditions(insertion_mm=task.actual_mm),
        )
    except ValueError as error:
        return {**about, "error": str(error)}
    began = time.process_time()
    stated = given.with_uncertainty(Uncertainty(insertions_mm=task.stated_mm))
    found = investigate(stated, case.laxity)
    seconds = time.process_time() - began
    about |= {"signal": case.truth.signal, "seconds": seconds}
    if found is None:
        return {**about, "verdict": Verdict.NOT_TESTABLE.value, "group": [], "causes": []}
    return {
        **about,
        **judged(case, found, with_gain=False),
        "beyond": _beyond(case, found),
        "power": _claimed_power(task.effect, case, found),
    }


def _beyond(case: BlindCase, found: Investigation) -> float:
    base = found.base.fitted
    values = {**case.truth.theta, **case.truth.stated_errors}
    true = [values.get(x, y) for x, y in zip(base.model.parameters.names, base.theta, strict=True)]
    exact = replace(base.laxity, coordinates=case.noise_free.coordinates)
    fitted = best_fit_from(base.model, exact, base.noise, [np.array(true), base.theta])
    return float(np.sqrt(fitted.deviance))


def _claimed_power(effect: str, case: BlindCase, found: Investigation) -> float | None:
    """What the test is said to find of an effect of the true size; None for one never seen."""
    step = found.attribution.steps[0]
    variant = step.typical(effect) if effect else None
    if variant is None:
        return None
    names = [variant.effect.parameters.names[i].partition(".")[2] for i in variant.moved]
    sizes = case.truth.amplitudes[effect]
    known = [
        sizes[x][0] - variant.values[i] if x in sizes else 0.0
        for x, i in zip(names, variant.moved, strict=True)
    ]
    amplitude: Array = np.array(known)
    return detection_power(step.test, step.projected(variant), amplitude)
