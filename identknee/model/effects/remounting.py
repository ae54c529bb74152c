"""Zero errors shared by all trials of a flexion angle, as from remounting the knee."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS
from identknee.model.effects.effect import ReplicaReadingError, TrialRecord, amplitudes
from identknee.model.effects.facts import REMOUNTING
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

# mm and deg: an estimate of how well a knee comes back to where it was, and the most it may miss.
ZERO_SD, FARTHEST = 0.5, 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Remounting(ReplicaReadingError):  # noqa: N818 - an error of reading
    """Offsets of the five coordinates at every flexion angle [mm, deg]."""

    def applied(self, knee: Knee, values: Array) -> Knee:
        """The knee with stated zero errors of the size found, to be marginalised."""
        offsets = values.reshape(-1, len(COORDINATES))
        mm, deg = (float(np.sqrt(np.mean(offsets[:, x] ** 2))) for x in (TRANSLATIONS, ROTATIONS))
        return knee.with_uncertainty(replace(knee.uncertainty, zero_mm=mm, zero_deg=deg))


def remounting(angles: Sequence[float]) -> Remounting:
    """Offsets of every coordinate at these flexion angles [deg]; elsewhere there are none."""
    names = [f"flexion{angle:g}_{name}" for angle in angles for name in COORDINATES]
    n = len(names)
    made = amplitudes(REMOUNTING, names, n * [ZERO_SD], upper=n * [FARTHEST])
    return Remounting(name=REMOUNTING, parameters=made, read=partial(_offset, np.array(angles)))


def _offset(angles: Array, coordinates: Array, values: Array, tests: TrialRecord) -> Array:
    offsets = values.reshape(*values.shape[:-1], len(angles), len(COORDINATES))
    is_there = tests.flexion_deg[:, None] == angles
    if values.ndim == 1:
        return np.asarray(coordinates + is_there @ offsets)
    copies = is_there.reshape(len(values), -1, len(angles))
    return np.asarray(coordinates + (copies @ offsets).reshape(coordinates.shape))
