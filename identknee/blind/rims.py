"""Whether contact stays away from the rims of the articular surfaces."""

import numpy as np
from scipy.spatial import cKDTree

from identknee.blind import energy
from identknee.blind.experiment import Experiment, ExperimentRun
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.subject.knee import Knee
from identknee.subject.surface import Surface

# mm; nearer to a rim the surface that would touch next is not known.
MARGIN = 3.0
REACH = 0.5  # mm, within which points of the tibia are looked at


@declared
class Rims:
    """Rims of the surfaces."""

    femur: cKDTree = entry("Points of the femoral rim in the femur's frame")
    tibia: tuple[tuple[cKDTree, cKDTree], ...] = entry(
        "Points of the rim of each tibial surface in the tibia's frame, with all its vertices"
    )


def rims_of(knee: Knee) -> Rims:
    """The rims of a knee's articular surfaces."""
    return Rims(
        femur=cKDTree(knee.femur_frame.to_local(_rim(knee.femur))),
        tibia=tuple(
            (
                cKDTree(knee.tibia_frame.to_local(_rim(x))),
                cKDTree(knee.tibia_frame.to_local(x.vertices)),
            )
            for x in knee.tibia
        ),
    )


def contact_stays_inside(experiment: Experiment, run: ExperimentRun, rims: Rims) -> bool:
    """Whether the middle of every contact of every trial is well inside both surfaces."""
    return all(_is_inside(experiment, R, t, rims) for R, t in run.poses)


def _rim(surface: Surface) -> Array:
    return np.asarray(surface.vertices[np.unique(surface.boundary_edges)])


def _is_inside(experiment: Experiment, R: Array, t: Array, rims: Rims) -> bool:
    knee = experiment.arrays()
    listed = energy.candidates(R, t, knee.surface, knee.field, REACH)
    touching = np.empty(len(experiment.points), np.int64)
    _, n = energy.energy_of(R, t, np.zeros(5), knee, listed, np.zeros(5), touching)
    points = experiment.points[touching[:n]]
    weight = experiment.areas[touching[:n]]
    # Of the sheets, the nearest one carries a point.
    distances = np.array([sheet.query(points)[0] for _, sheet in rims.tibia])
    for index, (rim, _) in enumerate(rims.tibia):
        own = distances.argmin(axis=0) == index
        if not own.any():
            continue
        middle = np.average(points[own], axis=0, weights=weight[own])
        if rim.query(middle)[0] < MARGIN or rims.femur.query(R @ middle + t)[0] < MARGIN:
            return False
    return True
