"""A diagnosis as xarray datasets."""

from collections.abc import Sequence

import numpy as np
import xarray

from identknee.diagnosis.diagnose import Diagnosis
from identknee.diagnosis.explanations.candidates import Exclusion
from identknee.laxity.table import COORDINATES
from identknee.report.groups import constant_data, observed_data


def diagnosis_groups(found: Diagnosis) -> dict[str, xarray.Dataset]:
    """Groups ``misfit``, ``residuals``, ``missing_wrench``, ``scores``, ``refits``, the data's."""
    return {
        "constant_data": constant_data(found.laxity.protocol),
        "observed_data": observed_data(found.laxity),
        "misfit": _misfit(found),
        "residuals": _residuals(found),
        "missing_wrench": _missing_wrench(found),
        "scores": _scores(found.exclusions),
        "refits": _refits(found),
    }


def _misfit(found: Diagnosis) -> xarray.Dataset:
    """Map of the misfit; NaN where a cell has no data or the parameters explain it."""
    cells = found.localisation.cells
    names = [x for x in COORDINATES if x in {y.coordinate for y in cells}]
    angles = sorted({x.flexion_deg for x in cells})
    directions = list(dict.fromkeys(x.direction for x in cells))
    values = np.full((2, len(names), len(angles), len(directions)), np.nan)
    for x in cells:
        place = (
            names.index(x.coordinate),
            angles.index(x.flexion_deg),
            directions.index(x.direction),
        )
        values[(slice(None), *place)] = x.score, x.p_value
    dims = ("coordinate", "flexion_deg", "direction")
    return xarray.Dataset(
        {"score": (dims, values[0]), "p_value": (dims, values[1])},
        coords={"coordinate": names, "flexion_deg": angles, "direction": directions},
        attrs={"sentence": found.localisation.sentence},
    )


def _residuals(found: Diagnosis) -> xarray.Dataset:
    """Measured less predicted, without and with the causes, and the noise found."""
    dims = ("trial", "coordinate")
    before, after = (
        x.fitted.compared.differences(x.fitted.theta) for x in (found.base, found.explanation)
    )
    return xarray.Dataset(
        {
            "before": (dims, before),
            "after": (dims, after),
            "sd": (dims, found.noise.sd),
        },
        coords={"trial": list(found.laxity.protocol.trials), "coordinate": list(COORDINATES)},
    )


def _missing_wrench(found: Diagnosis) -> xarray.Dataset:
    """What else would have to act in every trial, whole and outside contact, with its errors."""
    wrench, names = found.missing_wrench, ("varus_Nm", "internal_Nm", "x_N", "y_N", "z_N")
    by_name = {}
    for prefix, values, covariance in (
        ("whole", wrench.wrench, wrench.covariance),
        ("outside", wrench.outside, wrench.outside_covariance),
    ):
        sd = np.sqrt(np.einsum("nii->ni", covariance))
        for i, name in enumerate(names):
            to_user = 0.001 if name.endswith("_Nm") else 1.0
            by_name[f"{prefix}_{name}"] = ("trial", to_user * values[:, i])
            by_name[f"sd_{prefix}_{name}"] = ("trial", to_user * sd[:, i])
    return xarray.Dataset(by_name, coords={"trial": list(found.laxity.protocol.trials)})


def _scores(tested: Sequence[Exclusion]) -> xarray.Dataset:
    return xarray.Dataset(
        {
            name: ("effect", [getattr(x, name) for x in tested])
            for name in ("score", "p_value", "detectable", "relevant", "power")
        }
        | {"cell": ("effect", [x.cell.value for x in tested])},
        coords={
            "effect": [x.name for x in tested],
            "amplitude": ("effect", [x.parameter for x in tested]),
            "unit": ("effect", [x.unit for x in tested]),
        },
    )


def _refits(found: Diagnosis) -> xarray.Dataset:
    """All explanations compared in the end: the base model, the best ones, their rivals."""
    attribution = found.attribution
    rivals = [x for x in attribution.rivals if x.refit is not found.base]
    best = {" + ".join(x.names): x for x in (found.explanation, attribution.best) if x.causes}
    refits = [found.base, *best.values(), *(x.refit for x in rivals)]
    n_other = len(refits) - len(rivals)
    n = found.base.fitted.model.n_ligament_parameters
    return xarray.Dataset(
        {
            "log_evidence": ("explanation", [x.log_evidence for x in refits]),
            "chi_square": ("explanation", [x.fitted.misfit for x in refits]),
            "p_value": ("explanation", [x.misfit_p_value for x in refits]),
            "distance": ("explanation", [np.nan] * n_other + [x.distance for x in rivals]),
            "is_excluded": ("explanation", [False] * n_other + [x.is_excluded for x in rivals]),
            "state": ("explanation", ["-"] * n_other + [x.state.value for x in rivals]),
            "outcome": ("explanation", [x.fitted.outcome.value for x in refits]),
            "theta": (("explanation", "parameter"), np.array([x.fitted.theta[:n] for x in refits])),
        },
        coords={
            "explanation": [" + ".join(x.names) or "none" for x in refits],
            "parameter": list(found.base.fitted.model.parameters.names[:n]),
        },
    )
