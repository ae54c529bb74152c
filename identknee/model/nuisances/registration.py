"""Registration: the frames in which poses were measured are not those of the geometry."""

from dataclasses import field, replace

import numpy as np

from identknee.model.effects.effect import amplitudes
from identknee.model.measured_frames import frames_at, placements
from identknee.model.nuisances.loading import REACH
from identknee.model.parameters import Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.subject.uncertainty import BONES

NAMES = [f"{bone}_{axis}_{unit}" for bone in BONES for unit in ("deg", "mm") for axis in "xyz"]


@declared
class Registration:
    """The pose of each bone's measured frame in the frame of its geometry [deg, mm].

    A rigid transform of each bone: rotations about and shifts along the axes of the geometry's
    frame. The model moves between the measured frames: readings, axes and points of the loads and
    the flexion that the rig prescribes are theirs.
    """

    sd_deg: float = entry("Prior standard deviation of the rotations; 0 where there are none")
    sd_mm: float = entry("Prior standard deviation of the shifts; 0 where there are none")
    name: str = field(init=False, default="registration")
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        sds, used = self._sds, self._used
        made = amplitudes(
            self.name,
            [NAMES[i] for i in used],
            sds[used].tolist(),
            upper=(REACH * sds[used]).tolist(),
        )
        object.__setattr__(self, "parameters", made.as_nuisances())

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting whose poses are those between the frames at amplitudes `values`."""
        return replace(setting, frames=frames_at(self._whole(values[None])[0]))

    def placements(self, values: Array) -> tuple[Array, Array]:
        """Axes and origins of frames at k rows of amplitudes, ``(k, 2, 3, 3)``, ``(k, 2, 3)``."""
        return placements(self._whole(values))

    @property
    def _sds(self) -> Array:
        return np.array(2 * (3 * [self.sd_deg] + 3 * [self.sd_mm]))

    @property
    def _used(self) -> list[int]:
        return [int(x) for x in np.flatnonzero(self._sds)]

    def _whole(self, values: Array) -> Array:
        whole = np.zeros((len(values), len(NAMES)))
        whole[:, self._used] = values
        return whole
