"""Advice on trials to add as an xarray dataset and as the words of a summary."""

from typing import Any

import numpy as np
import xarray

from identknee.identify.design.design import Design
from identknee.laxity.protocol import FLEXION, LOADS, Protocol
from identknee.report.groups import Groups
from identknee.report.profile_groups import profile_groups, profile_summary

ENDS = ("lower", "upper")


def design_groups(found: Design, candidates: Protocol, parameters: tuple[str, ...]) -> Groups:
    """Groups ``design``, and ``profile_before`` and ``profile_after`` with the targets' curves.

    Dimensions of ``design`` are ``candidate``, ``step`` (0 before any trial is added), ``target``
    and ``end``; NaN is an open end, or the loss of a candidate that was not offered.
    """
    dataset = xarray.Dataset(
        {
            "loss_alone": ("candidate", found.alone),
            "failures": ("candidate", _failures(found)),
            "loss": ("step", found.losses),
            "predicted": (("step", "target", "end"), found.predicted),
            "sd": (("step", "target"), found.sds),
            "before": (("target", "end"), _ends(found, after=False)),
            "after": (("target", "end"), _ends(found, after=True)),
            "chosen": ("added", np.array(found.chosen, dtype=np.int64)),
        },
        coords={
            "candidate": list(found.names),
            FLEXION: ("candidate", candidates.flexion_deg),
            **{name: ("candidate", candidates.loads[:, i]) for i, name in enumerate(LOADS)},
            "step": np.arange(len(found.losses)),
            "target": list(found.targets),
            "unit": ("target", [x.unit for x in found.before]),
            "end": list(ENDS),
            "added": list(found.trials),
        },
        attrs={"criterion": found.criterion, "n_simulations": found.n_simulations},
    )
    return {
        "design": dataset,
        "profile_before": profile_groups(found.before, parameters)["profile"],
        "profile_after": profile_groups(found.after, parameters)["profile"],
    }


def design_summary(found: Design, candidates: Protocol) -> dict[str, Any]:
    """What ``result.json`` says of the advice; an open end is null."""
    rows = zip(found.chosen, found.losses[1:], found.predicted[1:], strict=True)
    return {
        "criterion": found.criterion,
        "trials": [
            {
                "trial": found.names[i],
                FLEXION: candidates.flexion_deg[i],
                **dict(zip(LOADS, candidates.loads[i], strict=True)),
                "loss": loss,
                "predicted": _by_target(found, predicted),
            }
            for i, loss, predicted in rows
        ],
        "loss_before": found.losses[0],
        "targets": {
            before.name: {
                "before": profile_summary(before),
                "predicted": dict(zip(ENDS, found.predicted[-1, t], strict=True)),
                "after": profile_summary(after),
                "sd_before": found.sds[0, t],
                "sd_after": found.sds[-1, t],
            }
            for t, (before, after) in enumerate(zip(found.before, found.after, strict=True))
        },
        "n_candidates": len(found.names),
        "excluded": [
            {"trial": x.name, "reason": x.sentence, "failures": x.failures, "tried": x.tried}
            for x in found.excluded
        ],
        "n_simulations": found.n_simulations,
    }


def _by_target(found: Design, predicted: np.ndarray) -> dict[str, Any]:
    return {
        name: dict(zip(ENDS, ends, strict=True))
        for name, ends in zip(found.targets, predicted, strict=True)
    }


def _failures(found: Design) -> np.ndarray:
    """At how many parameter sets each candidate has no prediction."""
    failures = {x.name: x.failures for x in found.excluded}
    return np.array([failures.get(name, 0) for name in found.names])


def _ends(found: Design, *, after: bool) -> np.ndarray:
    profiles = found.after if after else found.before
    ends = [[x.lower, x.upper] for x in profiles]
    return np.array([[np.nan if x is None else x for x in row] for row in ends], dtype=np.float64)
