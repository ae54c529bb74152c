"""Figures of a diagnosis, one function a figure, in the style of `identknee.report.figures`."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identknee.diagnose.attribution import Step
from identknee.diagnose.causes import explanation_of, ligament_estimates
from identknee.diagnose.curves import load_curves
from identknee.diagnose.diagnosis import Diagnosis
from identknee.diagnose.isolability import LEAST_DISTANCE, Distances
from identknee.diagnose.localisation import LEVEL, Localisation
from identknee.diagnose.noise_model import Curve
from identknee.diagnose.refit import Refit
from identknee.diagnose.score import ScoreTest
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES
from identknee.report.figures import BLACK, COLOURS, GREY, MARKERS, STYLES
from identknee.runs.arrays import Array

N_CANDIDATES = 3
LOAD_NAMES = ("internal moment", "varus moment", "anterior force", "distraction", "lateral force")
WORDS = {
    "lateral_shift_mm": "lateral shift [mm]",
    "anterior_drawer_mm": "anterior drawer [mm]",
    "distraction_mm": "distraction [mm]",
    "varus_deg": "varus [deg]",
    "internal_deg": "internal [deg]",
}


def misfit_figure(localisation: Localisation) -> Figure:
    """The map of misfit: scores by coordinate, flexion and load direction.

    Red where more was measured than predicted, blue where less. A ring marks scores that noise
    hardly leaves anywhere on the map, a cross cells that the parameters explain or without data.

    Parameters
    ----------
    localisation
        Of a diagnosis.
    """
    cells = localisation.cells
    rows = [x for x in COORDINATES if x in {y.coordinate for y in cells}]
    angles = sorted({x.flexion_deg for x in cells})
    directions = list(dict.fromkeys(x.direction for x in cells))
    columns = [(a, d) for a in angles for d in directions]
    scores = np.full((len(rows), len(columns)), np.nan)
    figure = Figure(figsize=(2.6 + 0.52 * len(columns), 2.5 + 0.42 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    for x in cells:
        place = rows.index(x.coordinate), columns.index((x.flexion_deg, x.direction))
        scores[place] = x.score
        weight = "bold" if x.p_value <= LEVEL else "normal"
        colour = "white" if abs(x.score) > 4 else BLACK
        axes.text(place[1], place[0], f"{x.score:.1f}", ha="center", va="center", fontsize=7,
                  color=colour, weight=weight)
    limit = max(5.0, float(np.nanmax(np.abs(scores), initial=0.0)))
    image = axes.imshow(scores, cmap="RdBu_r", vmin=-limit, vmax=limit, aspect="auto")
    figure.colorbar(image, ax=axes, label="score", shrink=0.8)
    return figure
