"""A sweep, its basins, recovery and cliffs: as xarray datasets, and in short."""

from typing import Any

import numpy as np
import xarray

from identknee.identify.shares import Share
from identknee.identify.sweep.basins import Basins
from identknee.identify.sweep.cliffs import CliffMap
from identknee.identify.sweep.survey import Survey
from identknee.identify.sweep.sweep import OUTCOMES, Sweep
from identknee.model.laxity_model import LaxityModel
from identknee.runs.arrays import Array, IntArray

# Basins in the summary; all are among the arrays.
MOST_LISTED = 20


def sweep_groups(survey: Survey, cliffs: CliffMap | None) -> dict[str, xarray.Dataset]:
    """Groups ``optimization``, ``basins``, ``recovery``, ``cliffs`` and ``timing``.

    Of these, ``timing`` alone differs when the sweep is repeated. Where nothing had a prediction
    there is no ``recovery`` and no ``cliffs``.
    """
    groups = {
        "optimization": _optimization(survey.sweep, survey.basins.labels),
        "basins": _basins(survey.basins),
        "timing": xarray.Dataset({"seconds": ("start", survey.sweep.seconds)}),
    }
    if survey.recoveries:
        groups["recovery"] = _recovery(survey)
    if cliffs is not None:
        groups["cliffs"] = _cliffs(cliffs)
    return groups


def sweep_summary(survey: Survey, cliffs: CliffMap | None) -> dict[str, Any]:
    """What ``result.json`` says of a sweep, in JSON types.

    ``kinds`` counts what is at the ends (minimum, valley, cliff, start_failed), ``outcomes`` how
    the optimizer ended, ``polished_outcomes`` how least squares ended that went on from there.
    ``objective`` is the lowest polished one. ``basins`` lists the first twenty of ``n_basins`` with
    their number and share of all starts (95 % Clopper-Pearson limits). ``unseen_mass`` is the share
    of starts, among those that end in a basin, that would show a new one. ``recovery`` has, for the
    ``end`` and the ``polished`` end, the share of starts that come ``within`` so many kN and % of
    the best end by their distance from it, and the ``radius`` within which nine of ten do; null for
    a radius beyond all starts. ``cliffs`` sums up the straight ways to the best end.
    ``seconds_per_start`` is there to see whether a start costs the same when there are more.
    """
    sweep, unseen = survey.sweep, survey.unseen
    names = sweep.parameters.names
    best = sweep.polished_objectives[sweep.best]
    return {
        "method": sweep.method,
        "n_starts": sweep.n,
        "budget": sweep.budget,
        "n_simulations": int(sweep.n_simulations.sum()),
        "n_polishing": int(sweep.n_polishing.sum()),
        "kinds": sweep.counts(sweep.kind_codes),
        "outcomes": sweep.counts(sweep.outcome_codes),
        "polished_outcomes": sweep.counts(sweep.polished_codes),
        "objective": best,
        "n_basins": len(survey.basins.basins),
        "basins": [
            {
                "objective": basin.objective,
                **_share(basin.share),
                "parameters": dict(zip(names, basin.theta.tolist(), strict=True)),
            }
            for basin in survey.basins.basins[:MOST_LISTED]
        ],
        "unseen_mass": {
            "estimate": unseen.estimate,
            "upper": unseen.upper,
            "n_basins_seen_once": unseen.n_once,
        },
        "recovery": {name: _recovered(survey, name) for name in survey.recoveries},
        "within": survey.within,
        "cliffs": None if cliffs is None else _cliff_summary(cliffs),
        "seconds_per_start": {
            "by_tenth_of_starts": [float(x.mean()) for x in tenths(sweep.seconds)],
            "deciles": np.quantile(sweep.seconds, np.linspace(0.0, 1.0, 11)).tolist(),
        },
    }


def tenths(values: Array) -> list[Array]:
    """`values` in ten parts in their order, fewer where there are fewer values."""
    return [part for part in np.array_split(values, 10) if part.size]


def trials_lost(model: LaxityModel, theta: Array) -> list[str]:
    """Names of the trials without an equilibrium at theta."""
    converged = model.predict(theta, derivatives=False).is_converged
    return [
        name
        for name, is_there in zip(model.protocol.trials, converged, strict=True)
        if not is_there
    ]


def _optimization(sweep: Sweep, labels: IntArray) -> xarray.Dataset:
    dims = ("start", "parameter")
    return xarray.Dataset(
        {
            "theta_start": (dims, sweep.starts),
            "theta": (dims, sweep.ends),
            "theta_polished": (dims, sweep.polished),
            "objective": ("start", sweep.objectives),
            "objective_polished": ("start", sweep.polished_objectives),
            "n_simulations": ("start", sweep.n_simulations),
            "n_polishing": ("start", sweep.n_polishing),
            "outcome": ("start", sweep.outcome_codes.astype(np.int8), _flags()),
            "kind": ("start", sweep.kind_codes.astype(np.int8), _flags()),
            "outcome_polished": ("start", sweep.polished_codes.astype(np.int8), _flags()),
            "basin": ("start", labels, {"none": -1}),
        },
        coords={"parameter": list(sweep.parameters.names)},
        attrs={"method": sweep.method, "budget": sweep.budget, "seed": sweep.seed},
    )


def _flags() -> dict[str, object]:
    """What the codes mean, as the CF conventions say it."""
    return {
        "flag_values": list(range(len(OUTCOMES))),
        "flag_meanings": " ".join(x.value for x in OUTCOMES),
    }


def _basins(basins: Basins) -> xarray.Dataset:
    found = basins.basins
    thetas = np.array([x.theta for x in found]).reshape(len(found), basins.parameters.n)
    return xarray.Dataset(
        {
            "theta": (("basin", "parameter"), thetas),
            "objective": ("basin", [x.objective for x in found]),
            "n_starts": ("basin", [x.share.count for x in found]),
            "share": ("basin", [x.share.value for x in found]),
            "share_lower": ("basin", [x.share.lower for x in found]),
            "share_upper": ("basin", [x.share.upper for x in found]),
        },
        coords={"parameter": list(basins.parameters.names)},
        attrs={"level": 0.95},
    )


def _recovery(survey: Survey) -> xarray.Dataset:
    dims = ("end", "distance")
    shares = [x.shares for x in survey.recoveries.values()]
    first = next(iter(survey.recoveries.values()))
    return xarray.Dataset(
        {
            "n_starts": ("distance", [x.n for x in first.shares]),
            **{
                name: (dims, [[getattr(x, field) for x in row] for row in shares])
                for name, field in (("share", "value"), ("lower", "lower"), ("upper", "upper"))
            },
        },
        coords={"end": list(survey.recoveries), "distance": first.distances},
        attrs={
            "distance": "mean absolute difference, kN or %, whichever is larger",
            "within": survey.within,
        },
    )


def _recovered(survey: Survey, name: str) -> dict[str, Any]:
    found, radius = survey.recoveries[name], survey.radii[name]
    return {
        "distances": found.distances.tolist(),
        "shares": [_share(x) for x in found.shares],
        "radius": radius.value,
        "radius_lower": radius.lower,
        "radius_upper": radius.upper,
        "probability": radius.probability,
    }


def _share(share: Share) -> dict[str, Any]:
    return {
        "n_starts": share.count,
        "share": share.value,
        "share_lower": share.lower,
        "share_upper": share.upper,
    }


def _cliff_summary(cliffs: CliffMap) -> dict[str, Any]:
    nearest = cliffs.edge_distances[cliffs.has_cliff]
    return {
        "n_ways": len(cliffs.starts),
        "n_ways_with_cliff": int(cliffs.has_cliff.sum()),
        "nearest_distance": float(nearest.min()) if nearest.size else None,
        "median_distance": float(np.median(nearest)) if nearest.size else None,
        "trials_lost": cliffs.counts(),
    }


def _cliffs(cliffs: CliffMap) -> xarray.Dataset:
    dims = ("way", "parameter")
    return xarray.Dataset(
        {
            "target": ("parameter", cliffs.target),
            "theta_start": (dims, cliffs.starts),
            "theta_edge": (dims, cliffs.edges),
            "edge_distance": ("way", cliffs.edge_distances),
            "share_lost": ("way", cliffs.share_lost),
            "lost": ("way", [", ".join(names) for names in cliffs.lost]),
        },
        coords={"parameter": list(cliffs.parameters.names)},
    )
