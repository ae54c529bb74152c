"""Results as xarray datasets, under ArviZ's group names where it has one."""

from collections.abc import Mapping

import numpy as np
import xarray

from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.stability import StabilityReport
from identknee.subject.knee import Knee

Groups = Mapping[str, xarray.Dataset]


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
