"""What a laxity model predicts as a flat list of outputs in named groups."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from identknee.laxity.table import COORDINATES
from identknee.laxity.unloaded import from_unloaded, unloaded_trials
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaxityOutputs:
    """Coordinates of every trial of a model as functions of its free parameters.

    Attributes
    ----------
    model
        The model under its protocol of n trials.
    groups
        Name of the group of every coordinate of every trial, trial after trial, ``5 n`` in all.
    free
        The parameters of the model that vary, and the values of the others.
    zero
        Whether coordinates are absolute, or changes from the unloaded pose of the flexion angle.

    Raises
    ------
    ValueError
        If the number of groups differs, or an unloaded pose is needed that the protocol lacks.
    """

    model: LaxityModel
    groups: tuple[str, ...]
    free: FreeParameters
    zero: Literal["absolute", "unloaded"] = "absolute"

    def __post_init__(self) -> None:
        wanted = len(COORDINATES) * self.model.protocol.n
        if len(self.groups) != wanted:
            raise ValueError(
                f"{wanted} outputs need as many names of groups, got {len(self.groups)}"
            )
        if self.zero == "unloaded":
            unloaded_trials(self.model.protocol)

    @property
    def parameters(self) -> Parameters:
        """Those that vary."""
        return self.free.parameters

    def evaluate(self, theta: Array) -> Array:
        """Coordinates of all trials [mm, deg], shape ``(5 n,)``; NaN where one did not converge."""
        everything = self.free.expand(theta)
        coordinates = self.model.predict(everything, derivatives=False).coordinates
        if self.zero == "unloaded":
            coordinates = from_unloaded(coordinates, self.model.protocol)
        return np.asarray(coordinates.ravel())
