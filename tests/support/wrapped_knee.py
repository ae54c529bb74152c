"""The reference knee with ligaments that wrap around cylinders and a sphere of both bones."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

import identknee as ik
from identknee.subject.knee import Knee
from identknee.subject.ligament import Obstacle

OBSTACLES: Mapping[str, Obstacle] = {
    # The medial rim of the plateau, and the lateral epicondyle.
    "MCL": Obstacle(
        bone="tibia", centre=np.array([6.0, -24.0, -26.0]), radius_mm=12.0,
        axis=np.array([2.0, 0.0, 0.3]), side=np.array([0.0, 0.0, -1.0]),
    ),
    "LCL": Obstacle(
        bone="femur", centre=np.array([-3.0, -12.0, 36.0]), radius_mm=11.0,
        axis=np.array([1.0, 0.0, 0.0]), side=np.array([0.0, 0.0, 1.0]),
    ),
    "PCL": Obstacle(bone="tibia", centre=np.array([-1.0, -19.0, -9.0]), radius_mm=7.0),
}  # fmt: skip


def wrapped_knee(obstacles: Mapping[str, Obstacle] = OBSTACLES) -> Knee:
    """The reference knee, these ligaments with an obstacle."""
    knee = ik.reference_knee()
    made = [replace(x, wrap=obstacles.get(x.name)) for x in knee.ligaments]
    return knee.with_ligaments(made)
