"""What the causes of a diagnosis gain, as its answer keeps it."""

from collections.abc import Mapping
from typing import Any

from identknee.diagnosis.folds import Rmse
from identknee.diagnosis.gain import (
    Assessment,
    ElpdDifference,
    FamilyDifference,
    Gain,
    ParameterChange,
    Process,
)
from identknee.diagnosis.misfit import Check
from identknee.runs.declare import declared, entry

OF_MODEL = "of the model without causes (before), with them (after), with a process (absorbed)"


@declared
class FamilyGain:
    """The gain on trials held out of one family: an angle, a direction, the largest loads."""

    elpd_difference: float = entry("Gain in log predictive density, in nats", unit="1")
    elpd_se: float = entry("Its standard error", unit="1")
    elpd_absorbed_difference: float = entry("The same of the process in place", unit="1")
    elpd_absorbed_se: float = entry("Its standard error", unit="1")
    folds: tuple[str, ...] = entry("Folds that count")
    without_signature: tuple[str, ...] = entry("Folds in which both models predict alike")
    not_scored: Mapping[str, str] = entry("Folds that could not be predicted, and why")
    rmse_held_out: Mapping[str, Rmse] = entry(f"Error of trials held out, {OF_MODEL}")
    rmse_held_out_expected: Mapping[str, Rmse] = entry(f"Error that it expects itself, {OF_MODEL}")


@declared
class GainFound:
    """What the causes gain over the model without them."""

    rmse_held_out_before: float = entry(
        "Error of trials held out without causes, in units of noise", unit="1"
    )
    rmse_held_out_after: float = entry("The same with the causes", unit="1")
    elpd_difference: float = entry(
        "Gain in log predictive density of trials held out, in nats", unit="1"
    )
    elpd_se: float = entry("Its standard error", unit="1")
    elpd_absorbed_difference: float = entry(
        "The same of a Gaussian process that takes up the misfit unnamed", unit="1"
    )
    elpd_absorbed_se: float = entry("Its standard error", unit="1")
    log_evidence_difference: float = entry("Log evidence with less without the causes", unit="1")
    rmse_in_sample: Mapping[str, Rmse] = entry(f"Error of the trials fitted, {OF_MODEL}")
    rmse_held_out: Mapping[str, Rmse] = entry(f"Error of trials held out, {OF_MODEL}")
    rmse_held_out_expected: Mapping[str, Rmse] = entry(f"Error that it expects itself, {OF_MODEL}")
    misfit: Mapping[str, Check] = entry(f"Test of the size of the misfit, {OF_MODEL}")
    families: Mapping[str, FamilyGain] = entry("Gain by what is held out")
    explained: Mapping[str, float] = entry("Share of each coordinate's misfit that goes")
    discrepancy: Process = entry("The process")
    parameters: Mapping[str, ParameterChange] = entry("Parameters of both models by name")
    forces: Mapping[str, Mapping[str, Mapping[str, float]]] = entry(
        "Force of each ligament under the largest loads, by trial, before_N and after_N", unit="N"
    )


def gain_found(gain: Gain) -> GainFound:
    """A gain as its answer keeps it."""
    models = {"before": gain.before, "after": gain.after, "absorbed": gain.absorbed}
    forces = gain.forces
    held_out = _held_out(gain, models)
    return GainFound(
        rmse_held_out_before=held_out["rmse_held_out"]["before"].noise,
        rmse_held_out_after=held_out["rmse_held_out"]["after"].noise,
        **_density(gain.elpd, gain.elpd_absorbed),
        log_evidence_difference=gain.log_evidence_difference,
        rmse_in_sample={name: x.in_sample for name, x in models.items()},
        **held_out,
        misfit={name: x.check for name, x in models.items()},
        families={
            one.family: FamilyGain(
                **_density(one, absorbed),
                folds=tuple(x.name for x in one.folds),
                without_signature=tuple(x.name for x in one.without_signature),
                not_scored={x.name: reason for x, reason in one.not_scored},
                **_held_out(gain, models, one.family),
            )
            for one, absorbed in zip(gain.elpd.families, gain.elpd_absorbed.families, strict=True)
        },
        explained=gain.explained,
        discrepancy=gain.discrepancy,
        parameters={x.name: x for x in gain.parameters},
        forces={
            trial: {
                ligament: {"before_N": float(before), "after_N": float(after)}
                for ligament, before, after in zip(forces.ligaments, *pair, strict=True)
            }
            for trial, *pair in zip(forces.trials, forces.before, forces.after, strict=True)
        },
    )


def _density(
    found: ElpdDifference | FamilyDifference, absorbed: ElpdDifference | FamilyDifference
) -> dict[str, Any]:
    return {
        "elpd_difference": found.difference,
        "elpd_se": found.se,
        "elpd_absorbed_difference": absorbed.difference,
        "elpd_absorbed_se": absorbed.se,
    }


def _held_out(
    gain: Gain, models: Mapping[str, Assessment], family: str | None = None
) -> dict[str, Any]:
    return {
        "rmse_held_out": {k: gain.rmse_held_out(x, family) for k, x in models.items()},
        "rmse_held_out_expected": {k: gain.expected_rmse(x, family) for k, x in models.items()},
    }
