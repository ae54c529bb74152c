"""A diagnosis as the flat, documented numbers of a summary."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from identknee.diagnosis.diagnose import Diagnosis
from identknee.diagnosis.explanations.candidates import Exclusion
from identknee.diagnosis.explanations.causes import (
    Cause,
    Estimate,
    causes_of,
    ligament_estimates,
)
from identknee.diagnosis.explanations.refit import Rival, RivalState
from identknee.diagnosis.explanations.verdict import Verdict
from identknee.diagnosis.missing_line.line import LineFinding
from identknee.diagnosis.missing_line.wrench import MissingPull
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import ROTATIONS, TRANSLATIONS
from identknee.model.effects.facts import FACTS
from identknee.report.gain_summary import gain_summary
from identknee.runs.arrays import Array
from identknee.runs.findings import findings_summary
from identknee.subject.knee import Knee


def diagnosis_summary(found: Diagnosis) -> dict[str, Any]:
    """What ``result.json`` says of a diagnosis.

    ``causes`` are those of the best explanation, where the verdict names any, or the line of force
    where no known cause explains the data; ``group`` are the names that the data leave open, those
    of the causes among them. ``parameters_before`` and ``parameters_after`` are the ligaments'
    without and with the causes, their 95 % intervals under the same keys with ``_ci95``. A rival
    whose ``state`` is not tested says why. ``effects`` says of every effect tried whether it was
    seen and which size would have been. Rivals that are open have their own amplitudes and
    parameters. ``missing_wrench`` is what else would have to act on the tibia, see
    `identknee.diagnosis.missing_line.wrench`.
    """
    conclusion, explanation = found.conclusion, found.explanation
    knee = found.base.fitted.model.knee
    before, after = ligament_estimates(found.base), ligament_estimates(explanation)
    return {
        "verdict": conclusion.verdict,
        "sentence": conclusion.sentence,
        "p_value": conclusion.p_value,
        "reasons": list(conclusion.reasons),
        "causes": [_cause(x, knee) for x in found.causes],
        "group": list(conclusion.group),
        "line": None if found.line is None else _line(found.line),
        "rivals": [_rival(x) for x in found.attribution.rivals],
        "misfit": _misfit(found),
        "missing_wrench": [_pull(x) for x in found.missing_pulls],
        "noise": _noise(found),
        "advised_trials": [] if found.advice is None else trials_summary(found.advice.trials),
        "advice": None if found.advice is None else _advice(found),
        "gain": None if found.gain is None else gain_summary(found.gain),
        "parameters_before": _values(before),
        "parameters_after": _values(after),
        "parameters_before_ci95": _intervals(before),
        "parameters_after_ci95": _intervals(after),
        "effects": {x.name: _tested(x) for x in found.exclusions},
        "findings": findings_summary(found.findings),
    }


def untestable_summary(reason: str) -> dict[str, Any]:
    """The same keys where the data cannot be tested, with the reason."""
    verdict = Verdict.NOT_TESTABLE
    empty: dict[str, Any] = {
        x: [] for x in ("causes", "group", "rivals", "advised_trials", "missing_wrench")
    }
    nothing = ("p_value", "line", "misfit", "noise", "advice", "gain")
    parameters = [f"parameters_{x}{y}" for x in ("before", "after") for y in ("", "_ci95")]
    return {
        "verdict": verdict,
        "sentence": verdict.sentence,
        "reasons": [reason],
        **empty,
        **dict.fromkeys((*nothing, *parameters)),
        "effects": {},
        "findings": [],
    }


def trials_summary(trials: Protocol) -> list[dict[str, Any]]:
    """Each trial with its angle and its loads, those of zero left out."""
    return [
        {
            "trial": name,
            "flexion_deg": float(angle),
            **{load: float(x) for load, x in zip(LOADS, row, strict=True) if x != 0.0},
        }
        for name, angle, row in zip(trials.trials, trials.flexion_deg, trials.loads, strict=True)
    ]


def _cause(cause: Cause, knee: Knee) -> dict[str, Any]:
    size = cause.amplitude
    return {
        "name": cause.name,
        "amplitude": size.value,
        "unit": size.unit,
        "ci95": list(size.ci95),
        "parameter": size.name,
        "parameters": {x.name: _estimate(x) for x in cause.parameters},
        "line": None if cause.line is None else _ends(knee.as_scanned(cause.line)),
        "meaning": FACTS[cause.name].sentence,
        "source": FACTS[cause.name].source,
    }


def _ends(line: Array) -> dict[str, Array]:
    return {"femur": line[0], "tibia": line[1]}


def _estimate(estimate: Estimate) -> dict[str, Any]:
    return {"value": estimate.value, "unit": estimate.unit, "ci95": list(estimate.ci95)}


def _line(line: LineFinding) -> dict[str, Any]:
    """The line of force where no known cause explains the data, ends in the axes of the scan."""
    knee = line.refit.fitted.model.knee
    return {
        "is_line": line.is_line,
        "sentence": line.sentence,
        **_ends(knee.as_scanned(np.stack([line.femur, line.tibia]))),
        "offset_95_mm": line.offset_95,
        "angle_95_deg": line.angle_95_deg,
        "side": line.side,
        "near": dict(line.place.shares),
        "force_N": line.force,
        "force_ci95_N": line.force_interval,
        "force_trial": line.trial,
        "p_value": line.p_value,
    }


def _pull(pull: MissingPull) -> dict[str, Any]:
    values, errors = (x * [1.0, 1.0, 0.001] for x in (pull.mean, pull.sd))
    names = ("anterior_force_N", "lateral_force_N", "internal_moment_Nm")
    return {
        "flexion_deg": pull.flexion_deg,
        "direction": pull.direction,
        "n_trials": pull.n_trials,
        "p_value": pull.p_value,
        **dict(zip(names, values.tolist(), strict=True)),
        **{f"sd_{name}": x for name, x in zip(names, errors.tolist(), strict=True)},
    }


def _rival(rival: Rival) -> dict[str, Any]:
    is_open, knee = rival.state is RivalState.OPEN, rival.refit.fitted.model.knee
    is_tested = rival.state is not RivalState.NOT_TESTED
    return {
        "causes": list(rival.refit.names),
        "log_evidence_below": rival.log_evidence_deficit if is_tested else None,
        "distance": rival.distance if is_tested else None,
        "state": rival.state.value,
        "reason": rival.reason or None,
        "could_matter": rival.could_matter,
        "is_excluded": rival.is_excluded,
        "amplitudes": [_cause(x, knee) for x in causes_of(rival.refit)] if is_open else [],
        "parameters": _values(ligament_estimates(rival.refit)) if is_open else None,
    }


def _misfit(found: Diagnosis) -> dict[str, Any]:
    base, best = found.base, found.explanation
    return {
        "sentence": found.localisation.sentence,
        "share": found.localisation.share,
        "cells": [
            {
                "coordinate": x.coordinate,
                "flexion_deg": x.flexion_deg,
                "direction": x.direction,
                "score": x.score,
                "p_value": x.p_value,
            }
            for x in found.localisation.region
        ],
        "chi_square_before": base.fitted.misfit,
        "chi_square_after": best.fitted.misfit,
        "n_measured": base.fitted.n_data,
        "p_value_before": base.misfit_p_value,
        "p_value_after": best.misfit_p_value,
        "p_value_largest_score": found.attribution.steps[0].scores.p_value,
    }


def _noise(found: Diagnosis) -> dict[str, Any]:
    noise = found.noise
    sizes = {
        unit: _median(noise.sd[:, columns])
        for unit, columns in (("mm", TRANSLATIONS), ("deg", ROTATIONS))
    }
    return {
        "sentence": noise.sentence,
        "source": noise.source,
        "sd": sizes,
        "within_trial_correlation": noise.correlation,
        "times_stated": None if noise.factors is None else list(noise.factors),
        "degrees_of_freedom": noise.degrees_of_freedom,
    }


def _advice(found: Diagnosis) -> dict[str, Any]:
    advice = found.advice
    if advice is None:  # pragma: no cover - asked only where there is some
        raise AssertionError
    return {
        "sentence": advice.sentence,
        "rivals": [list(x) for x in advice.rivals],
        "distance_before": advice.before,
        "distance_after": advice.after,
    }


def _tested(effect: Exclusion) -> dict[str, Any]:
    return {
        "cell": effect.cell,
        "score": effect.score,
        "p_value": effect.p_value,
        "parameter": effect.parameter,
        "unit": effect.unit,
        "detectable": effect.detectable,
        "relevant": effect.relevant,
        "power": effect.power,
    }


def _values(tree: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, float]]:
    return {owner: {k: x.value for k, x in own.items()} for owner, own in tree.items()}


def _intervals(tree: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, Any]]:
    return {owner: {k: list(x.ci95) for k, x in own.items()} for owner, own in tree.items()}


def _median(values: Iterable[Any]) -> float | None:
    known = np.asarray(values)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if known.size else None
