"""A gain as a flat, documented table of numbers for files."""

from typing import Any

import numpy as np

from identknee.diagnosis.gain.gain import (
    Assessment,
    ElpdDifference,
    ForceChange,
    Gain,
    ParameterChange,
)


def gain_summary(gain: Gain) -> dict[str, Any]:
    """The gain by name, ready for JSON; null where a number is not known.

    ``rmse_held_out_before`` and ``rmse_held_out_after`` are in units of the noise, all measured
    coordinates and all families of folds together; ``elpd_difference`` and ``elpd_se`` are in nats.
    Below them the same in mm and deg, by family of folds, for the base model (``before``), the
    cause (``after``) and a Gaussian process in its place (``absorbed``), beside what each expects.
    """
    models = {"before": gain.before, "after": gain.after, "absorbed": gain.absorbed}
    return {
        "rmse_held_out_before": _number(gain.rmse_held_out(gain.before).noise),
        "rmse_held_out_after": _number(gain.rmse_held_out(gain.after).noise),
        "elpd_difference": _number(gain.elpd.difference),
        "elpd_se": _number(gain.elpd.se),
        "elpd_absorbed_difference": _number(gain.elpd_absorbed.difference),
        "elpd_absorbed_se": _number(gain.elpd_absorbed.se),
        "log_evidence_difference": _number(gain.log_evidence_difference),
        "rmse_in_sample": {name: x.in_sample.to_json() for name, x in models.items()},
        "rmse_held_out": {name: gain.rmse_held_out(x).to_json() for name, x in models.items()},
        "rmse_held_out_expected": {
            name: gain.expected_rmse(x).to_json() for name, x in models.items()
        },
        "misfit": {name: _misfit(x) for name, x in models.items()},
        "families": _families(gain, models),
        "explained": {name: _number(x) for name, x in gain.explained.items()},
        "discrepancy": {
            "absorbed": _number(gain.discrepancy.absorbed),
            "degrees_of_freedom": _number(gain.discrepancy.degrees_of_freedom),
            "flexion_length": _number(gain.discrepancy.flexion_length),
            "load_length": _number(gain.discrepancy.load_length),
        },
        "parameters": {x.name: _change(x) for x in gain.parameters},
        "forces": _forces(gain.forces),
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _misfit(assessed: Assessment) -> dict[str, float | None]:
    check = assessed.check
    return {
        "statistic": _number(check.statistic),
        "degrees_of_freedom": check.degrees_of_freedom,
        "p_value": _number(check.p_value),
    }


def _families(gain: Gain, models: dict[str, Assessment]) -> dict[str, Any]:
    absorbed = _by_family(gain.elpd_absorbed)
    return {
        family: {
            **found,
            "elpd_absorbed_difference": absorbed[family]["elpd_difference"],
            "elpd_absorbed_se": absorbed[family]["elpd_se"],
            "rmse_held_out": {
                name: gain.rmse_held_out(x, family).to_json() for name, x in models.items()
            },
            "rmse_held_out_expected": {
                name: gain.expected_rmse(x, family).to_json() for name, x in models.items()
            },
        }
        for family, found in _by_family(gain.elpd).items()
    }


def _by_family(elpd: ElpdDifference) -> dict[str, dict[str, Any]]:
    return {
        x.family: {
            "elpd_difference": _number(x.difference),
            "elpd_se": _number(x.se),
            "folds": [fold.name for fold in x.folds],
            "without_signature": [fold.name for fold in x.without_signature],
            "not_scored": {fold.name: reason for fold, reason in x.not_scored},
        }
        for x in elpd.families
    }


def _change(change: ParameterChange) -> dict[str, Any]:
    return {
        "before": change.before,
        "after": change.after,
        "ci95_before": list(change.interval_before),
        "ci95_after": list(change.interval_after),
        "shift_in_se": _number(change.shift),
        "interval_ratio": _number(change.interval_ratio),
    }


def _forces(forces: ForceChange) -> dict[str, Any]:
    """Force before and after [N] of each trial and ligament."""
    return {
        trial: {
            ligament: {
                "before_N": _number(forces.before[i, j]),
                "after_N": _number(forces.after[i, j]),
            }
            for j, ligament in enumerate(forces.ligaments)
        }
        for i, trial in enumerate(forces.trials)
    }
