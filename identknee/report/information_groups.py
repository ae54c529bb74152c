"""Local geometry as xarray datasets and as the words of a summary."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray

from identknee.identify.information.geodesic import Geodesic
from identknee.identify.information.information import Information
from identknee.identify.information.structure import StructureCheck
from identknee.report.groups import Groups

# Pairs and triples worth saying.
N_COLLINEAR = 3


def information_groups(
    found: Information, structure: StructureCheck, paths: Sequence[Geodesic]
) -> Groups:
    """Groups ``fisher``, ``structure`` and, one for each geodesic, ``geodesic_0`` and so on."""
    names = list(found.parameters.names)
    fisher = xarray.Dataset(
        {
            "eigenvalue": ("direction", found.eigenvalues),
            "floor": ("direction", found.floors),
            "eigenvector": (("parameter", "direction"), found.eigenvectors),
            "information": (("parameter", "other_parameter"), found.matrix),
            "correlation": (("parameter", "other_parameter"), found.correlation),
            "sd": ("parameter", found.sd),
            "scale": ("parameter", found.scales),
            "theta": ("parameter", found.theta),
        },
        coords={
            "parameter": names,
            "other_parameter": names,
            "direction": np.arange(1, len(names) + 1),
        },
        attrs={"scaling": found.scaling, "rounding": found.noise.rounding},
    )
    ranks = xarray.Dataset(
        {
            "theta": (("point", "parameter"), structure.thetas),
            "rank": ("point", structure.ranks),
            "singular_value": (("point", "direction"), structure.singular_values),
            "has_no_influence": (("point", "parameter"), structure.has_no_influence),
        },
        coords={"parameter": names, "direction": np.arange(1, len(names) + 1)},
        attrs={"verdict": structure.verdict.value, "seed": structure.seed},
    )
    geodesics = {f"geodesic_{i}": _path(path, names) for i, path in enumerate(paths)}
    return {"fisher": fisher, "structure": ranks, **geodesics}


def information_summary(
    found: Information, structure: StructureCheck, paths: Sequence[Geodesic]
) -> dict[str, Any]:
    """What ``result.json`` says of them; an infinite number is null."""
    names = found.parameters.names
    return {
        "scaling": found.scaling,
        "scales": dict(zip(names, found.scales, strict=True)),
        "theta": dict(zip(names, found.theta, strict=True)),
        "eigenvalues": [
            {
                "value": value,
                "floor": found.floors[i],
                "above_noise": value > found.floors[i],
                "combination": found.combination(i),
            }
            for i, value in enumerate(found.eigenvalues)
        ],
        "n_above_noise": found.n_above_noise,
        "condition": found.condition,
        "sd": dict(zip(names, found.sd, strict=True)),
        "collinearity": found.collinearity(),
        "collinear": [
            {"parameters": chosen, "collinearity": index}
            for size in (2, 3)
            if size <= found.parameters.n
            for chosen, index in found.collinear_sets(size)[:N_COLLINEAR]
        ],
        "structure": {
            "verdict": structure.verdict.value,
            "sentence": structure.verdict.sentence,
            "rank": structure.rank,
            "undetermined": structure.undetermined,
            "n_points": len(structure.ranks),
            "n_with_prediction": int(structure.has_prediction.sum()),
        },
        "geodesics": [
            {
                "boundary": path.boundary.value,
                "involved": path.involved,
                "sentence": path.sentence,
                "end": dict(zip(names, path.thetas[-1], strict=True)),
                "length": path.lengths[-1],
                "rise_of_deviance": path.deviances[-1] - path.deviances[0],
                "n_simulations": path.n_simulations,
            }
            for path in paths
        ],
        "n_simulations": found.n_simulations
        + len(structure.ranks)
        + sum(path.n_simulations for path in paths),
    }


def _path(path: Geodesic, names: list[str]) -> xarray.Dataset:
    return xarray.Dataset(
        {
            "theta": (("point", "parameter"), path.thetas),
            "direction": (("point", "parameter"), path.directions),
            "speed": ("point", path.speeds),
            "deviance": ("point", path.deviances),
            "length": ("point", path.lengths),
        },
        coords={"parameter": names},
        attrs={"boundary": path.boundary.value, "involved": ", ".join(path.involved)},
    )
