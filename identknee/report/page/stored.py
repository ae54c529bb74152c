"""Results as the library's own types again, from what a verb stored of them."""

import numpy as np
import xarray

from identknee.diagnosis.explanations.causes import Estimate
from identknee.diagnosis.score.localisation import CellScore, Localisation
from identknee.report.page.results import Result
from identknee.runs.arrays import Array


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
