"""What a laxity model predicts as a flat list of outputs in named groups."""

from dataclasses import dataclass

import numpy as np

from identknee.laxity.table import COORDINATES
from identknee.laxity.zeros import ABSOLUTE, from_zero, zero_trials
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
        What coordinates are counted from, as in `identknee.Laxity`.

    Raises
    ------
    ValueError
        If the number of groups differs, or a pose is needed that the protocol lacks.
    """

    model: LaxityModel
    groups: tuple[str, ...]
    free: FreeParameters
    zero: str = ABSOLUTE

    def __post_init__(self) -> None:
        wanted = len(COORDINATES) * self.model.protocol.n
        if len(self.groups) != wanted:
            raise ValueError(
                f"{wanted} outputs need as many names of groups, got {len(self.groups)}"
            )
        if self.zero != ABSOLUTE:
            zero_trials(self.model.protocol, self.zero)

    @property
    def parameters(self) -> Parameters:
        """Those that vary."""
        return self.free.parameters

    def evaluate(self, theta: Array) -> Array:
        """Coordinates of all trials [mm, deg], shape ``(5 n,)``; NaN where one did not converge."""
        everything = self.free.expand(theta)
        coordinates = self.model.predict(everything, derivatives=False).coordinates
        return np.asarray(from_zero(coordinates, self.model.protocol, self.zero).ravel())
