"""What a laxity model predicts as a flat list of outputs in named groups."""

import numpy as np

from identknee.laxity.table import COORDINATES
from identknee.laxity.zeros import ABSOLUTE, from_zero, zero_trials
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import FreeParameters, Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry


@declared
class LaxityOutputs:
    """Coordinates of every trial of a model as functions of its free parameters.

    Raises
    ------
    ValueError
        If the number of groups differs, or a pose is needed that the protocol lacks.
    """

    model: LaxityModel = entry("The model under its protocol of n trials")
    groups: tuple[str, ...] = entry(
        "Name of the group of every coordinate of every trial, trial after trial, ``5 n`` in all"
    )
    free: FreeParameters = entry(
        "The parameters of the model that vary, and the values of the others"
    )
    zero: str = entry(
        "What coordinates are counted from, as in `identknee.Laxity`", default=ABSOLUTE
    )

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
