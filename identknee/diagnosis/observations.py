"""The measured values of a laxity table row by row, as predictions of them are scored."""

from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.noise_model import NoiseModel
from identknee.laxity.table import ROTATIONS, Laxity
from identknee.runs.arrays import Array, BoolArray, IntArray, frozen, frozen_integers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rmse:
    """Root-mean-square errors; NaN where there is nothing to compare.

    Attributes
    ----------
    mm
        Of the translations [mm].
    deg
        Of the rotations [deg].
    noise
        Of all values, each in units of its own noise: 1 where nothing but noise is left.
    """

    mm: float
    deg: float
    noise: float

    def to_json(self) -> dict[str, float | None]:
        """The same by name; null where there is nothing to compare."""
        values = {"mm": self.mm, "deg": self.deg, "noise": self.noise}
        return {name: x if np.isfinite(x) else None for name, x in values.items()}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observations:
    """What is known of the m measured values besides their size.

    Attributes
    ----------
    trial
        The trial of each, shape ``(m,)``.
    coordinate
        Its place in `identknee.laxity.table.COORDINATES`, shape ``(m,)``.
    sd
        Standard deviation of its noise alone, in its unit, shape ``(m,)``, > 0.
    noise
        Of all errors, nuisances included.
    n_trials
        Trials of the protocol, those that measured nothing included.
    """

    trial: IntArray
    coordinate: IntArray
    sd: Array
    noise: NoiseModel
    n_trials: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "trial", frozen_integers(self.trial))
        object.__setattr__(self, "coordinate", frozen_integers(self.coordinate))
        object.__setattr__(self, "sd", frozen(self.sd, len(self.trial), name="sd"))

    @property
    def is_angle(self) -> BoolArray:
        """Whether a value is a rotation, shape ``(m,)``."""
        return np.asarray(self.coordinate >= ROTATIONS.start)

    def rmse(self, errors: Array) -> Rmse:
        """Root-mean-square of errors in mm and deg, shape ``(..., m)``; NaN is left out."""
        squares = errors**2
        return Rmse(
            mm=_root_mean(squares[..., ~self.is_angle]),
            deg=_root_mean(squares[..., self.is_angle]),
            noise=_root_mean(squares / self.sd**2),
        )


def observations_of(laxity: Laxity, sd: Array, noise: NoiseModel) -> Observations:
    """The measured values of `laxity`.

    Parameters
    ----------
    laxity
        The table.
    sd
        Standard deviation of the noise of each value, shape ``(n, 5)``; read where measured.
    noise
        Of the measured values, nuisances included.
    """
    trial, coordinate = np.nonzero(laxity.is_measured)
    return Observations(
        trial=trial,
        coordinate=coordinate,
        sd=sd[laxity.is_measured],
        noise=noise,
        n_trials=laxity.n,
    )


def _root_mean(squares: Array) -> float:
    known = squares[~np.isnan(squares)]
    return float(np.sqrt(known.mean())) if known.size else float("nan")
