"""Results as the library's own types again, from what a verb stored of them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray

from identknee.diagnosis.explanations.causes import Estimate
from identknee.diagnosis.score.localisation import CellScore, Localisation
from identknee.identify.profile.result import Profile, ProfileVerdict, Side, SideStatus
from identknee.report.page.results import Result
from identknee.runs.arrays import Array
from identknee.verbs.profile import Profiles


def stored_profiles(result: Result) -> tuple[Profile, ...]:
    """The profiles that a profile or a demo left, in their order; none of other verbs."""
    if isinstance(result.answer, Profiles):
        return result.answer.profiles
    entries = result.summary.get("profiles", {})
    curves = result.groups.get("profile")
    if curves is None:
        return ()
    names = [str(x) for x in curves["quantity"].values]
    return tuple(_profile(name, entries[name], curves.sel(quantity=name)) for name in names)


def stored_localisation(result: Result) -> Localisation:
    """The map of misfit that a diagnosis left."""
    scores = result.groups["misfit"].stack(cell=("coordinate", "flexion_deg", "direction"))
    cells = tuple(
        CellScore(
            coordinate=str(place[0]),
            flexion_deg=float(place[1]),
            direction=str(place[2]),
            score=float(score),
            p_value=float(p_value),
        )
        for place, score, p_value in zip(
            scores["cell"].values, scores["score"].values, scores["p_value"].values, strict=True
        )
        if np.isfinite(score)
    )
    misfit = result.summary["misfit"]
    region = {(x["coordinate"], x["flexion_deg"], x["direction"]) for x in misfit["cells"]}
    inside = [x for x in cells if (x.coordinate, x.flexion_deg, x.direction) in region]
    inside.sort(key=lambda x: -abs(x.score))
    return Localisation(cells=cells, region=tuple(inside), share=float(misfit["share"]))


def stored_estimates(result: Result, when: str) -> dict[str, dict[str, Estimate]]:
    """The ligaments' parameters that a diagnosis left, ``"before"`` or ``"after"`` its causes."""
    values = result.summary[f"parameters_{when}"] or {}
    intervals = result.summary[f"parameters_{when}_ci95"] or {}
    return {
        ligament: {
            name: Estimate(
                name=name,
                value=float(value),
                unit="%" if name.endswith("_pct") else "kN",
                ci95=(intervals[ligament][name][0], intervals[ligament][name][1]),
            )
            for name, value in own.items()
        }
        for ligament, own in values.items()
    }


def coordinates(dataset: xarray.Dataset, name: str = "coordinates") -> Array:
    """A variable by trial and coordinate, shape ``(n, 5)``."""
    return np.asarray(dataset[name].transpose(..., "trial", "coordinate").values, dtype=np.float64)


def _profile(name: str, entry: Mapping[str, Any], curve: xarray.Dataset) -> Profile:
    known = np.isfinite(curve["value"].values)

    def points(variable: str) -> Array:
        return np.asarray(curve[variable].values[known], dtype=np.float64)

    deltas = points("delta_deviance")
    lower, upper = (_side(entry, side) for side in ("lower", "upper"))
    return Profile(
        name=name,
        unit=entry["unit"],
        level=float(entry["level"]),
        threshold=float(entry["threshold"]),
        optimum=curve["optimum"].values,
        optimum_value=float(entry["value"]),
        deviance=float(np.median(2.0 * points("nll") - deltas)),
        values=points("value"),
        thetas=points("theta"),
        deltas=deltas,
        slopes=points("slope"),
        branches=points("branch").astype(np.int64),
        intervals=tuple((low, high) for low, high in entry["intervals"]),
        lower_side=lower,
        upper_side=upper,
        verdict=ProfileVerdict(entry["verdict"]),
        practical_level=float(entry["practical_level"]),
        n_simulations=int(entry["n_simulations"]),
        better_optimum=None,
        n_restarts=int(entry["n_restarts"]),
    )


def _side(entry: Mapping[str, Any], side: str) -> Side:
    said = entry[f"{side}_side"]
    error = said["error"]
    return Side(
        status=SideStatus(entry[f"{side}_status"]),
        end=entry[side],
        error=float("nan") if error is None else float(error),
        reached=float(said["reached"]),
        max_deviance=float(said["max_deviance"]),
        at_bounds=tuple(said["at_bounds"]),
    )
