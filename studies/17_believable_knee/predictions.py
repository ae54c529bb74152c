"""What a fit of the study predicts of trials that it did not see, and how sure it is."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import identknee as ik
from identknee.calibrate.problem import Problem, evaluate
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.candidate_laxity import continued_from_own_poses
from identknee.model.discrepancy import SmoothDiscrepancy
from identknee.runs.declare import Array, IntArray
from identknee.verbs.fit import extended_by_fit, prediction_uncertainty

# What a load moves most: the value that laxity is judged by.
JUDGED = {
    "Anterior": "anterior_drawer_mm",
    "Posterior": "anterior_drawer_mm",
    "Internal": "internal_deg",
    "External": "internal_deg",
    "Varus": "varus_deg",
    "Valgus": "varus_deg",
}
SECOND_DEVICE = Path(__file__).parent / "second_device.csv"
ZERO = "0lb"
Value = list[str | float | None]


@dataclass(frozen=True, kw_only=True)
class FittedModel:
    """A model where a fit ended, and the data that it was fitted to.

    Attributes
    ----------
    model, laxity, theta
        The model of the data, these with their noise, and the parameters found.
    problem
        Residuals in units of the noise: of data, limits and priors.
    error
        The smooth error of the model that was averaged over; None for none.
    """

    model: ik.LaxityModel
    laxity: Laxity
    theta: Array
    problem: Problem
    error: SmoothDiscrepancy | None = None


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Predictions of some trials: means (n, 5), their covariance (5 n, 5 n), and what noise adds.

    The noise has a standard deviation for each coordinate and degrees of freedom, infinite where
    it was stated.
    """

    mean: Array
    covariance: Array
    noise: Array
    degrees_of_freedom: float


def predicted(fitted: FittedModel, protocol: Protocol) -> Predicted:
    """What a fit predicts of trials, none of whose poses are looked at.

    Without an error of the model the noise is what the fit left, as for ``fit --hold-out``. With
    one it is the noise that was stated, and what the residuals say of the error at the trials asked
    for is part of the prediction (universal kriging).
    """
    base = fitted.model.predict(fitted.theta)
    knee = extended_by_fit(fitted.model, base)
    model = continued_from_own_poses(ik.LaxityModel(knee=knee, protocol=protocol), fitted.theta)
    found = model.predict(fitted.theta)
    if found.jacobian is None or base.jacobian is None:
        raise AssertionError
    mean, slopes = found.coordinates.ravel(), found.jacobian.reshape(-1, fitted.theta.size)
    stated = _stated_noise(fitted.laxity)
    if fitted.error is None:
        covariance, noise, degrees = prediction_uncertainty(
            fitted.problem, fitted.laxity, fitted.theta
        )
        return Predicted(
            mean=found.coordinates,
            covariance=slopes @ covariance @ slopes.T,
            noise=noise * stated,
            degrees_of_freedom=degrees,
        )
    trial, coordinate = np.nonzero(fitted.laxity.is_measured)
    own = _places(fitted.laxity.protocol, fitted.laxity.protocol, trial, coordinate)
    asked = _places(
        fitted.laxity.protocol,
        protocol,
        np.repeat(np.arange(protocol.n), len(COORDINATES)),
        np.tile(np.arange(len(COORDINATES)), protocol.n),
    )
    left = (fitted.laxity.coordinates - base.coordinates)[trial, coordinate]
    of_data = _covariance(fitted.error, own, own) + np.diag(stated[coordinate] ** 2)
    between = _covariance(fitted.error, asked, own)
    weights = np.linalg.solve(of_data, between.T).T
    moved = slopes - weights @ base.jacobian[trial, coordinate]
    rest = _covariance(fitted.error, asked, asked) - weights @ between.T
    return Predicted(
        mean=(mean + weights @ left).reshape(-1, len(COORDINATES)),
        covariance=moved @ _of_parameters(fitted) @ moved.T + rest,
        noise=stated,
        degrees_of_freedom=np.inf,
    )


def values(found: Predicted, measured: Laxity) -> list[Value]:
    """Trial, coordinate, measured and predicted value and its deviation, of all that is measured.

    The standard deviation is that of the parameters, of stated errors and of noise together.
    """
    spread = np.diag(found.covariance).reshape(found.mean.shape)
    sd = np.sqrt(spread + found.noise**2)
    return [
        [
            measured.protocol.trials[i],
            COORDINATES[j],
            float(measured.coordinates[i, j]),
            float(found.mean[i, j]),
            float(sd[i, j]),
        ]
        for i, j in np.argwhere(measured.is_measured).tolist()
    ]


def second_device() -> Laxity:
    """The specimen's table from the other apparatus, near 30 deg."""
    return ik.read_laxity(SECOND_DEVICE)


def changes(found: Predicted, measured: Laxity) -> list[Value]:
    """Trial, coordinate, measured and predicted change, and deviation without and with noise.

    Each is the change of what the load moves from the unloaded trial of its series. Both readings
    have the noise of the fit.
    """
    trials, n = list(measured.protocol.trials), len(COORDINATES)
    made: list[Value] = []
    for i, name in enumerate(trials):
        series, _, load = name.rpartition("_")
        if load == ZERO:
            continue
        zero, j = trials.index(f"{series}_{ZERO}"), COORDINATES.index(JUDGED[series.split("_")[0]])
        pair = [i * n + j, zero * n + j]
        (here, between), (_, there) = found.covariance[np.ix_(pair, pair)].tolist()
        variance = here - 2.0 * between + there
        made.append(
            [
                name,
                COORDINATES[j],
                float(measured.coordinates[i, j] - measured.coordinates[zero, j]),
                float(found.mean[i, j] - found.mean[zero, j]),
                float(np.sqrt(variance)),
                float(np.sqrt(variance + 2.0 * found.noise[j] ** 2)),
            ]
        )
    return made


def _stated_noise(laxity: Laxity) -> Array:
    """The noise of each coordinate, which is one for all trials here, shape ``(5,)``."""
    if laxity.sd is None:
        raise AssertionError
    return np.asarray(np.nanmax(laxity.sd, axis=0))


def _of_parameters(fitted: FittedModel) -> Array:
    """Covariance of the parameters; one without a prior is known to lie within its bounds."""
    parameters = fitted.problem.parameters
    weak = np.diag(np.sqrt(12.0) / (parameters.upper - parameters.lower))
    rows = np.vstack(
        [evaluate(fitted.problem, fitted.theta).jacobian, weak[parameters.is_of_interest]]
    )
    return np.asarray(np.linalg.inv(rows.T @ rows))


def _places(
    fitted: Protocol, protocol: Protocol, trial: IntArray, coordinate: IntArray
) -> tuple[Array, IntArray]:
    """Flexion and loads of values in the units of the trials fitted, and their coordinates."""
    reach = max(float(np.ptp(fitted.flexion_deg)), 1.0)
    largest = np.abs(fitted.loads).max(axis=0)
    loads = protocol.loads / np.where(largest > 0.0, largest, 1.0)
    return np.column_stack([protocol.flexion_deg / reach, loads])[trial], coordinate


def _covariance(
    error: SmoothDiscrepancy, one: tuple[Array, IntArray], other: tuple[Array, IntArray]
) -> Array:
    """Covariance of the error of the model between values at some places and at others."""
    lengths = np.array([error.flexion_length, *(error.load_length for _ in LOADS)])
    apart = (one[0] / lengths)[:, None] - other[0] / lengths
    alike = one[1][:, None] == other[1]
    sds = np.outer(error.sd[one[1]], error.sd[other[1]])
    return np.asarray(sds * alike * np.exp(-0.5 * (apart**2).sum(axis=2)))
