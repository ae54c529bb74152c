"""Trials kept from a fit and predicted by it, each value with how well it is predicted."""

import fnmatch
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.problem import Problem
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.laxity.zeros import ABSOLUTE
from identknee.model.candidate_laxity import at_own_poses
from identknee.model.laxity_model import LaxityModel
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import OF_COORDINATE, declared, derived, entry
from identknee.runs.errors import suggestion
from identknee.subject.knee import Knee

LEVEL = 0.9
MOST_NAMED = 6
ROUNDS = 20


@declared
class HeldValue:
    """A measured value that the fit did not see, and its prediction."""

    trial: str = entry("Name of the trial")
    coordinate: str = entry("Name of the coordinate")
    measured: float = entry("Measured value", unit=OF_COORDINATE)
    predicted: float = entry("Predicted value; null where the model has none", unit=OF_COORDINATE)
    sd: float = entry(
        "Standard deviation of the prediction, to first order: of noise as large as the fit left, "
        "of parameters and of stated errors",
        unit=OF_COORDINATE,
    )


@declared
class HeldOut:
    """What a fit predicts of the trials that were kept from it."""

    values: tuple[HeldValue, ...] = entry("The measured values of these trials")
    degrees_of_freedom: float = entry("Of the noise that the fit left", unit="1")

    @property
    @derived("Names of the trials")
    def trials(self) -> tuple[str, ...]:
        """Names of the trials."""
        return tuple(dict.fromkeys(x.trial for x in self.values))

    @property
    @derived("Trials in which the model has no prediction")
    def lost(self) -> tuple[str, ...]:
        """Trials in which the model has no prediction."""
        return tuple(dict.fromkeys(x.trial for x in self.values if np.isnan(x.predicted)))

    @property
    @derived("Root-mean-square error by coordinate", unit=OF_COORDINATE)
    def rmse(self) -> dict[str, float]:
        """Root-mean-square error of the values predicted, by coordinate."""
        return {
            name: float(np.sqrt(np.mean(own**2)))
            for name in COORDINATES
            if (own := self._errors([x for x in self.values if x.coordinate == name])).size
        }

    @property
    @derived("Share of the values predicted that lie in their 90 % intervals", unit="1")
    def within_90(self) -> float:
        """Share of the values predicted that lie in their 90 % intervals; NaN without any."""
        reach = stdtrit(self.degrees_of_freedom, 0.5 + 0.5 * LEVEL)
        known = [x for x in self.values if not np.isnan(x.predicted)]
        if not known:
            return float("nan")
        return float(np.mean([abs(x.predicted - x.measured) <= reach * x.sd for x in known]))

    @staticmethod
    def _errors(values: Sequence[HeldValue]) -> Array:
        errors = np.array([x.predicted - x.measured for x in values])
        return np.asarray(errors[~np.isnan(errors)])


def split(laxity: Laxity, held_out: Sequence[str]) -> tuple[Laxity, BoolArray]:
    """The data with the cells of the trials held out blank, and which these are, shape ``(n,)``.

    Parameters
    ----------
    laxity
        The data.
    held_out
        Names of trials, ``*`` standing for any letters.

    Raises
    ------
    ValueError
        If no trial is called so, none is left, or coordinates are not absolute.
    """
    if held_out and laxity.zero != ABSOLUTE:
        raise ValueError(
            "--hold-out predicts absolute coordinates, and those of the table count from the zero "
            f"{laxity.zero}; leave cells blank instead"
        )
    trials = laxity.protocol.trials
    held = np.zeros(laxity.n, bool)
    for name in held_out:
        own = np.array([fnmatch.fnmatchcase(x, name) for x in trials])
        if not own.any():
            raise ValueError(
                f"--hold-out {name}: there is no such trial. "
                f"{suggestion(name, trials, most=MOST_NAMED)}"
            )
        held |= own
    if not (laxity.is_measured.any(axis=1) & ~held).any():
        raise ValueError("--hold-out leaves no trial to fit to; hold out fewer")
    blank = np.where(held[:, None], np.nan, laxity.coordinates)
    return (replace(laxity, coordinates=blank) if held.any() else laxity), held


def predicted(
    knee: Knee, fitted: tuple[Problem, Laxity, Array], measured: Laxity, fixed: Sequence[str]
) -> HeldOut:
    """What the fitted knee predicts of trials, none of whose measured poses are looked at.

    Parameters
    ----------
    knee
        The subject with the parameters, errors and poses of the fit.
    fitted
        The problem of the fit, in residuals of its data, those data, and where it ended.
    measured
        The trials held out.
    fixed
        Parameters that were not fitted.
    """
    problem, data, theta = fitted
    covariance, noise, degrees = _uncertainty(problem, data, theta, fixed)
    model = LaxityModel(
        knee=knee, protocol=measured.protocol, order=measured.order, phase=measured.phase
    )
    found = at_own_poses(model, theta).predict(theta)
    if found.jacobian is None:  # pragma: no cover - it was asked for
        raise AssertionError
    spread = np.einsum("nip,pq,niq->ni", found.jacobian, covariance, found.jacobian)
    sd = np.sqrt(spread + noise**2)
    values = tuple(
        HeldValue(
            trial=measured.protocol.trials[i],
            coordinate=COORDINATES[j],
            measured=float(measured.coordinates[i, j]),
            predicted=float(found.coordinates[i, j]),
            sd=float(sd[i, j]),
        )
        for i, j in np.argwhere(measured.is_measured).tolist()
    )
    return HeldOut(values=values, degrees_of_freedom=degrees)


def _uncertainty(
    problem: Problem, data: Laxity, theta: Array, fixed: Sequence[str]
) -> tuple[Array, Array, float]:
    """Covariance of the parameters, noise by coordinate (5,), its degrees of freedom.

    The noise of lengths and that of angles are what the fit leaves over their own degrees of
    freedom. A parameter without a prior is known to lie within its bounds.
    """
    parameters, at = problem.parameters, evaluate(problem, theta)
    is_angle = np.isin(np.nonzero(data.is_measured)[1], np.arange(5)[ROTATIONS]).astype(int)
    n, residuals = is_angle.size, at.residuals[: is_angle.size]
    free = ~np.isin(parameters.names, list(fixed))
    weak = np.diag(np.sqrt(12.0) / (parameters.upper - parameters.lower))
    rows = np.vstack([at.jacobian[n:], weak[parameters.is_of_interest]])[:, free]
    jacobian, size = at.jacobian[:n, free], np.ones(2)
    known = rows.T @ rows
    for _ in range(ROUNDS):
        scaled = jacobian / size[is_angle][:, None]
        covariance = np.linalg.inv(scaled.T @ scaled + known)
        left = 1.0 - np.einsum("ip,pq,iq->i", scaled, covariance, scaled)
        degrees = np.maximum(np.bincount(is_angle, weights=left, minlength=2), 1.0)
        squares = np.bincount(is_angle, weights=residuals**2, minlength=2)
        size = np.where(squares > 0.0, np.sqrt(squares / degrees), 1.0)
    whole = np.zeros((parameters.n, parameters.n))
    whole[np.ix_(free, free)] = covariance
    noise = np.empty(len(COORDINATES))
    noise[TRANSLATIONS], noise[ROTATIONS] = size
    return whole, noise, float(degrees.sum())
