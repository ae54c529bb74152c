"""Results as xarray datasets, under ArviZ's group names where it has one."""

from collections.abc import Mapping

import numpy as np
import xarray

from identknee.calibrate.fit import Fit
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.simulate import Simulation
from identknee.model.stability import StabilityReport
from identknee.model.tensions import tensions_of
from identknee.subject.knee import Knee

Groups = Mapping[str, xarray.Dataset]


def simulation_groups(simulation: Simulation, noisy: Laxity | None = None) -> Groups:
    """Groups ``constant_data`` and ``predictions``; ``observed_data`` where there is noise."""
    groups = {
        "constant_data": constant_data(simulation.model.protocol),
        "predictions": _predictions(simulation),
    }
    if noisy is not None:
        groups["observed_data"] = observed_data(noisy)
    return groups


def fit_groups(fit: Fit, fitted: Simulation, laxity: Laxity) -> Groups:
    """Groups ``constant_data``, ``observed_data``, ``predictions`` and ``optimization``."""
    return {
        "constant_data": constant_data(laxity.protocol),
        "observed_data": observed_data(laxity),
        "predictions": _predictions(fitted),
        "optimization": optimization(fit),
    }


def stability_groups(report: StabilityReport) -> Groups:
    """Group ``stability``: by trial at the subject's own parameters, by sample in the box."""
    return {
        "stability": xarray.Dataset(
            {
                "outcome": ("trial", [x.value for x in report.outcomes]),
                "margin_N_per_mm": ("trial", report.margins),
                "box_margin_N_per_mm": ("sample", report.box_margins),
                "change_by_contact_points": ("coordinate", report.change),
            },
            coords={"trial": list(report.trials), "coordinate": list(COORDINATES)},
        )
    }


def subject_groups(knee: Knee) -> Groups:
    """Group ``subject``: the ligaments."""
    ligaments = knee.ligaments
    return {
        "subject": xarray.Dataset(
            {
                "femur_mm": (("ligament", "axis"), np.array([x.femur for x in ligaments])),
                "tibia_mm": (("ligament", "axis"), np.array([x.tibia for x in ligaments])),
                "reference_length_mm": ("ligament", knee.reference_lengths),
                "stiffness_kN": ("ligament", [x.stiffness_kN for x in ligaments]),
                "reference_strain_pct": ("ligament", [x.reference_strain_pct for x in ligaments]),
            },
            coords={"ligament": [x.name for x in ligaments], "axis": ["x", "y", "z"]},
            attrs={"name": knee.name, "side": knee.side},
        )
    }


def optimization(fit: Fit) -> xarray.Dataset:
    """Dataset of a fit: theta, start and bounds by parameter, best objective by improvement."""
    parameters = fit.parameters
    return xarray.Dataset(
        {
            "theta": ("parameter", fit.theta),
            "start": ("parameter", fit.start),
            "lower": ("parameter", parameters.lower),
            "upper": ("parameter", parameters.upper),
            "is_fixed": ("parameter", np.isin(parameters.names, fit.fixed)),
            "simulation": ("improvement", fit.history[:, 0]),
            "best_objective": ("improvement", fit.history[:, 1]),
        },
        coords={"parameter": list(parameters.names)},
        attrs={"method": fit.method, "outcome": fit.outcome.value, "seed": fit.seed},
    )


def constant_data(protocol: Protocol) -> xarray.Dataset:
    """Dataset of a protocol: flexion and loads by trial."""
    return xarray.Dataset(
        {
            "flexion_deg": ("trial", protocol.flexion_deg),
            "loads": (("trial", "load"), protocol.loads),
        },
        coords={"trial": list(protocol.trials), "load": list(LOADS)},
        attrs={"protocol": protocol.name},
    )


def observed_data(laxity: Laxity) -> xarray.Dataset:
    """Dataset of measured laxity, with its noise where stated."""
    dims = ("trial", "coordinate")
    variables = {"coordinates": (dims, laxity.coordinates)}
    if laxity.sd is not None:
        variables["sd"] = (dims, laxity.sd)
    return xarray.Dataset(
        variables,
        coords={"trial": list(laxity.protocol.trials), "coordinate": list(COORDINATES)},
        attrs={
            "zero": laxity.zero,
            "within_trial_correlation": laxity.within_trial_correlation,
        },
    )


def _predictions(simulation: Simulation) -> xarray.Dataset:
    model, prediction = simulation.model, simulation.prediction
    return xarray.Dataset(
        {
            "coordinates": (("trial", "coordinate"), prediction.coordinates),
            "outcome": ("trial", [x.value for x in prediction.outcomes]),
            "margin_N_per_mm": ("trial", prediction.margins),
            "rim_share": ("trial", prediction.rim_share),
            "tension_N": (("trial", "ligament"), tensions_of(model, prediction)),
            "theta": ("parameter", prediction.theta),
        },
        coords={
            "trial": list(model.protocol.trials),
            "coordinate": list(COORDINATES),
            "ligament": [x.name for x in model.knee.ligaments],
            "parameter": list(model.parameters.names),
        },
    )
