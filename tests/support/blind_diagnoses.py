"""Blind cases diagnosed: one case a task, its outcome in plain numbers."""

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from blind_axes import conditions_of
from knees import knee

from identknee.blind.case import BlindCase, blind_case
from identknee.blind.scoring import score
from identknee.calibrate.fit import named_start
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.protocol import Protocol, concatenate, load_protocol
from identknee.laxity.table import Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.runs.schema import summary_of
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import diagnosis_of


@dataclass(frozen=True, slots=True, kw_only=True)
class BlindTask:
    """A blind case to be made and diagnosed.

    ``sd_factor`` multiplies the stated noise, ``start`` names one more start of the fit, and
    ``adds_trials`` repeats the diagnosis with the trials that the first one advises. ``axis`` is
    what of the generator is varied, a name in `blind_axes.AXES`, or empty.
    """

    subject: str
    effects: tuple[str, ...]
    signal: float | None
    seed: int
    sd_factor: float = 1.0
    start: str = ""
    adds_trials: bool = False
    measures_gain: bool = True
    axis: str = ""


def outcome_of(task: BlindTask) -> dict[str, Any]:
    """What came of a task; ``error`` where no case could be drawn."""
    subject = knee(task.subject)
    try:
        case = blind_case(
            subject,
            seed=task.seed,
            effect=list(task.effects) or None,
            signal=task.signal,
            conditions=conditions_of(task.axis, subject),
        )
    except ValueError as error:
        return {"error": str(error), "effects": list(task.effects), "signal": task.signal}
    laxity = _restated(case.laxity, task.sd_factor)
    began = time.perf_counter()
    found = investigate(subject, laxity, starts=_starts(subject, task.start))
    seconds = time.perf_counter() - began
    outcome: dict[str, Any] = {
        "effects": list(task.effects),
        "wanted": task.signal,
        "signal": case.truth.signal,
        "is_largest": case.truth.is_largest,
        "seed": task.seed,
        "seconds": seconds,
    }
    if found is None:
        return {**outcome, "verdict": Verdict.NOT_TESTABLE.value, "group": [], "causes": []}
    outcome |= judged(case, found, with_gain=task.measures_gain)
    if task.adds_trials and found.advice is not None:
        outcome["added"] = _with_added(subject, task, case, found.advice.trials)
    return outcome


def judged(case: BlindCase, found: Investigation, *, with_gain: bool) -> dict[str, Any]:
    """A diagnosis beside the truth of its case, in plain numbers."""
    summary = summary_of(diagnosis_of(found))
    told = score(case.truth, summary)
    best = found.attribution.best
    return {
        "verdict": told.verdict,
        "causes": [x["name"] for x in summary["causes"]],
        "group": summary["group"],
        "correct": told.correct,
        "wrong": told.wrong,
        "in_group": told.in_group,
        "p_value": found.conclusion.p_value,
        "p_after": best.misfit_p_value,
        "covered": told.amplitudes_covered,
        "stiffness_error": list(told.stiffness_error_kN),
        "strain_error": list(told.strain_error_pct),
        "coverage": [told.covered_before, told.covered_after],
        "line": [told.line_offset_mm, told.line_angle_deg],
        "nearest": _nearest(found, case.truth.effects),
        "held_out": _held_out(found) if with_gain else None,
    }


def _nearest(found: Investigation, hidden: tuple[str, ...]) -> float | None:
    """Distance of the nearest other explanation from that by what is hidden, where it was tried."""
    best = found.attribution.best
    if set(best.names) != set(hidden):
        return None
    others = [x.distance for x in found.attribution.rivals]
    return min(others, default=None)


def _held_out(found: Investigation) -> dict[str, float] | None:
    if found.conclusion.verdict is not Verdict.NAMED:
        return None
    gain = found.gain
    assert gain is not None
    return {
        "flexion_before": gain.before.held_out.rmse("flexion").noise,
        "flexion_after": gain.after.held_out.rmse("flexion").noise,
        "all_before": gain.rmse_held_out(gain.before).noise,
        "all_after": gain.rmse_held_out(gain.after).noise,
        "expected_after": gain.expected_rmse(gain.after).noise,
        "elpd": gain.elpd.difference,
        "elpd_se": gain.elpd.se,
        "elpd_absorbed": gain.elpd_absorbed.difference,
    }


def _with_added(
    subject: Knee, task: BlindTask, case: BlindCase, trials: Protocol
) -> dict[str, Any] | None:
    """The diagnosis with the advised trials made too; None where they have no equilibrium."""
    protocol = concatenate([load_protocol("seed63"), trials], name="with advised trials")
    (effect,) = task.effects
    size = case.truth.amplitudes[effect]["amplitude"][0]
    try:
        again = blind_case(
            subject, seed=task.seed, effect=[effect], amplitude=size, protocol=protocol
        )
    except ValueError:
        return None
    if again.truth.theta != case.truth.theta:
        return None
    found = investigate(subject, again.laxity)
    if found is None:
        return None
    again_judged = judged(again, found, with_gain=False)
    return {x: again_judged[x] for x in ("verdict", "causes", "group", "correct", "wrong")}


def _restated(laxity: Laxity, factor: float) -> Laxity:
    if factor == 1.0 or laxity.sd is None:
        return laxity
    return replace(laxity, sd=np.asarray(laxity.sd) * factor)


def _starts(subject: Knee, name: str) -> list[np.ndarray]:
    if not name:
        return []
    model = LaxityModel(knee=subject, protocol=load_protocol("seed63"), effects=())
    return [named_start(name, model.parameters)]
