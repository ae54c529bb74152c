"""Equivalent sets as an xarray dataset, and in short."""

from typing import Any

import numpy as np
import xarray

from identknee.identify.equivalents.equivalents import Equivalents, Extrema
from identknee.identify.equivalents.search import Side
from identknee.laxity.table import COORDINATES
from identknee.model.laxity_model import LaxityModel
from identknee.model.tensions import tensions_of
from identknee.runs.arrays import Array

SIDES = ("lower", "upper")


def equivalents_groups(
    found: Equivalents, model: LaxityModel, thetas: Array
) -> dict[str, xarray.Dataset]:
    """Group ``equivalent_sets``: the sets, what they predict, and the extrema of all quantities.

    Parameters
    ----------
    found
        The sets.
    model
        The model that predicts.
    thetas
        All parameters of the model at every set, those held fixed included, shape
        ``(n_sets, p)``.
    """
    predictions = [model.predict(theta, derivatives=False) for theta in thetas]
    names = list(found.parameters.names)
    return {
        "equivalent_sets": xarray.Dataset(
            {
                "theta": (("set", "parameter"), found.sets),
                "fit": ("parameter", found.fit),
                "step": ("parameter", found.steps),
                "distance": (("set", "block"), found.distances),
                "coordinates": (
                    ("set", "trial", "coordinate"),
                    np.array([x.coordinates for x in predictions]),
                ),
                "tension_N": (
                    ("set", "trial", "ligament"),
                    np.array([tensions_of(model, x) for x in predictions]),
                ),
                "diameter": ((), found.diameter),
                "farthest_pair": (("end", "parameter"), found.pair),
                "pair_search": ("search", found.pair_searches),
                **_extrema_variables(found),
            },
            coords={
                "parameter": names,
                "block": list(found.blocks),
                "trial": list(model.protocol.trials),
                "coordinate": list(COORDINATES),
                "ligament": [x.name for x in model.knee.ligaments],
                "quantity": [x.name for x in found.extrema],
                "side": list(SIDES),
            },
            attrs={"limit": found.limit, "outcome": found.outcome.value, "seed": found.seed},
        )
    }


def equivalents_summary(found: Equivalents) -> dict[str, Any]:
    """What ``result.json`` says of equivalent sets, in JSON types."""
    n = found.parameters.n
    return {
        "outcome": found.outcome.value,
        "sentence": found.outcome.sentence,
        "limit": found.limit,
        "blocks": found.blocks,
        "n_sets": len(found.sets),
        "largest_distance": found.distances.max(),
        "diameter": found.diameter,
        "farthest": found.farthest,
        "closest": found.closest,
        "unit_of_diameter": "typical steps: 3 kN, 2 % or the prior's sd",
        "pair_searches": found.pair_searches,
        "n_simulations": found.n_simulations,
        "parameters": {x.name: _extrema(x) for x in found.extrema[:n]},
        "quantities": {x.name: _extrema(x) for x in found.extrema[n:]},
    }


def _extrema(of: Extrema) -> dict[str, Any]:
    row: dict[str, Any] = {"unit": of.unit, "fit": of.at_fit}
    for name in SIDES:
        side: Side = getattr(of, name)
        row |= {
            name: side.value,
            f"{name}_end": side.end.value,
            f"{name}_at_bounds": side.at_bounds,
            f"{name}_distance": side.distance,
            f"{name}_agreeing": f"{side.n_agreeing} of {side.n_searches}",
        }
    return row


def _extrema_variables(found: Equivalents) -> dict[str, Any]:
    sides = [[getattr(x, name) for name in SIDES] for x in found.extrema]
    dims = ("quantity", "side")
    return {
        "at_fit": ("quantity", [x.at_fit for x in found.extrema]),
        "unit": ("quantity", [x.unit for x in found.extrema]),
        "extremum": (dims, [[x.value for x in row] for row in sides]),
        "extremum_end": (dims, [[x.end.value for x in row] for row in sides]),
        "extremum_distance": (dims, [[x.distance for x in row] for row in sides]),
        "extremum_searches": (dims, [[x.n_searches for x in row] for row in sides]),
        "extremum_agreeing": (dims, [[x.n_agreeing for x in row] for row in sides]),
        "extremum_theta": ((*dims, "parameter"), [[x.theta for x in row] for row in sides]),
    }
