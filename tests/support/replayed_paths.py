"""In-situ forces that a robot would measure on a knee, with the errors of cell and pose."""

from collections.abc import Sequence

import numpy as np

from identknee.laxity.forces import WRENCH, Superposition
from identknee.model.force_residuals import structure_wrenches
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

SD_N, SD_NM = 5.0, 0.2
SD = np.array([SD_N] * 3 + [SD_NM] * 3)
Row = tuple[str, str, str, str]


def in_situ_forces(
    model: LaxityModel,
    theta: Array,
    rows: Sequence[Row],
    *,
    pose_sd: tuple[float, float] = (0.0, 0.0),
    sizes: bool = False,
    generator: np.random.Generator | None = None,
) -> Superposition:
    """Forces of rows of trial, cut, state before and after; without errors if no generator.

    Each reading has its own error of the cell, which consecutive cuts share, and each run of a path
    its own error of the pose. With `sizes` only the size of a force is known.
    """
    trials = [model.protocol.trials.index(x[0]) for x in rows]
    found = structure_wrenches(model, model.predict(theta), trials, [x[1] for x in rows])
    wrenches = np.array(found.values)
    if generator is not None:
        readings: dict[tuple[str, str], Array] = {}
        runs: dict[tuple[str, str], Array] = {}
        spread = np.repeat([pose_sd[0], np.radians(pose_sd[1])], 3)
        for i, (trial, _, before, after) in enumerate(rows):
            for state in (before, after):
                drawn = generator.normal(scale=SD / np.sqrt(2.0))
                readings.setdefault((trial, state), drawn)
            run = runs.setdefault((trial, before), generator.normal(scale=1.0, size=6) * spread)
            wrenches[i] += readings[trial, after] - readings[trial, before]
            wrenches[i] += found.by_twist[i] @ run
    values = np.full((len(rows), len(WRENCH) + 1), np.nan)
    sd = np.tile(np.r_[SD, SD_N], (len(rows), 1))
    if sizes:
        values[:, -1] = np.linalg.norm(wrenches[:, :3], axis=1)
    else:
        values[:, :-1] = wrenches
    texts = [tuple(column) for column in zip(*rows, strict=True)]
    return Superposition(
        trials=texts[0],
        cut=texts[1],
        before=texts[2],
        after=texts[3],
        values=values,
        sd=sd,
        pose_sd=np.tile(pose_sd, (len(rows), 1)),
    )
