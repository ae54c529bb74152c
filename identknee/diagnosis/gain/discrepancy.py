"""A Gaussian process in place of a cause: it absorbs misfit without explaining it."""

from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.problem import Problem
from identknee.diagnosis.gain.folds import Observations
from identknee.diagnosis.score.misfit import Projector, base_projector
from identknee.laxity.protocol import Protocol
from identknee.runs.arrays import Array
from identknee.runs.declare import array, declared, entry

# Bounds of a coordinate's standard deviation of discrepancy, in units of its noise.
LEAST_SPREAD, MOST_SPREAD = 1e-2, 1e2
# Bounds of a correlation length, where flexion and each load vary between 0 and 1, or -1 and 1.
LEAST_LENGTH, MOST_LENGTH = 0.4, 5.0
START_SPREAD, START_LENGTH = 1.0, 0.7
MOST_ITERATIONS = 30


@declared
class Discrepancy:
    """A Gaussian process in each coordinate that has taken up what the model leaves."""

    spread: Array = array(
        "Its standard deviation in each measured coordinate, in units of the noise",
        "measured_coordinate",
    )
    flexion_length: float = entry("Correlation length over the range of flexion")
    load_length: float = entry("Correlation length over the largest load of each kind")
    errors: Array = array(
        "What it leaves in the data it was fitted to, measured less predicted",
        "value",
        unit="mm or deg",
    )
    absorbed: float = entry("Share of the misfit that it takes up, 0 to 1")
    degrees_of_freedom: float = entry("How many free parameters it is worth")
    observations: Observations = entry(
        "The measured values with it among their errors, for a prediction of held trials"
    )


def fit_discrepancy(
    problem: Problem, observations: Observations, theta: Array, protocol: Protocol
) -> Discrepancy:
    """The Gaussian process that takes up most of what a fitted model leaves.

    A process in each coordinate, smooth in flexion and loads, from which everything is taken out
    that a change of the fitted parameters could do, so that it leaves the fit as it is. Its
    spreads and lengths are those of highest marginal likelihood.

    Parameters
    ----------
    problem
        Predicted less measured values in mm and deg.
    observations
        The measured values.
    theta
        The fit, shape ``(p,)``.
    protocol
        The trials.

    References
    ----------
    M. C. Kennedy and A. O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63
    (2001) 425-464, doi:10.1111/1467-9868.00294; M. Plumlee, Bayesian calibration of inexact
    computer models, J. Am. Stat. Assoc. 112 (2017) 1274-1285, doi:10.1080/01621459.2016.1211016.
    """
    at, noise = evaluate(problem, theta), observations.noise
    projector = base_projector(noise.whiten(at.jacobian))
    kernel = _Kernel(observations, projector, protocol)
    target = projector.project(noise.whiten(-at.residuals))
    start = np.log(np.r_[np.full(kernel.n_coordinates, START_SPREAD), 2 * [START_LENGTH]])
    spreads, lengths = (LEAST_SPREAD, MOST_SPREAD), (LEAST_LENGTH, MOST_LENGTH)
    found = minimize(
        kernel.misfit,
        start,
        args=(target,),
        jac=True,
        method="L-BFGS-B",
        bounds=np.log([*[spreads] * kernel.n_coordinates, lengths, lengths]),
        options={"maxiter": MOST_ITERATIONS, "ftol": 1e-6},
    )
    values = np.exp(found.x)
    own = kernel.projected(kernel.covariance(found.x))
    # What the process absorbs of each value, by kriging.
    absorbing = cho_solve(cho_factor(np.eye(len(own)) + own), own)
    left = target - absorbing.T @ target
    return Discrepancy(
        spread=values[:-2],
        flexion_length=float(values[-2]),
        load_length=float(values[-1]),
        errors=-at.residuals - noise.factor @ (absorbing.T @ target),
        absorbed=float(1.0 - left @ left / (target @ target)) if target.any() else 0.0,
        degrees_of_freedom=float(np.trace(absorbing)),
        observations=replace(
            observations, noise=noise.widened(noise.factor @ own @ noise.factor.T)
        ),
    )


class _Kernel:
    """Squared-exponential covariances of the measured values, and their marginal likelihood."""

    def __init__(
        self, observations: Observations, projector: Projector, protocol: Protocol
    ) -> None:
        trial = observations.trial
        flexion = protocol.flexion_deg[trial] / max(float(np.ptp(protocol.flexion_deg)), 1.0)
        largest = np.abs(protocol.loads).max(axis=0)
        loads = (protocol.loads / np.where(largest > 0, largest, 1.0))[trial]
        self._flexion = (flexion[:, None] - flexion) ** 2
        self._load = ((loads[:, None] - loads) ** 2).sum(axis=2)
        self._pairs = np.outer(observations.sd, observations.sd)
        coordinates = np.unique(observations.coordinate)
        self._own = observations.coordinate[:, None] == coordinates
        self.n_coordinates = len(coordinates)
        # Whitens and projects at once.
        self._reduce = projector.project(observations.noise.whiten(np.eye(len(trial))))

    def covariance(self, logs: Array) -> Array:
        """Covariance of the values [mm, deg], before projection, shape ``(m, m)``."""
        shape = -0.5 * self._flexion * np.exp(-2 * logs[-2])
        shape = shape - 0.5 * self._load * np.exp(-2 * logs[-1])
        spread = self._own * np.exp(logs[:-2])
        return np.asarray(self._pairs * np.exp(shape) * (spread @ spread.T))

    def projected(self, covariance: Array) -> Array:
        """Whitened, without what the fitted parameters explain."""
        return np.asarray(self._reduce @ covariance @ self._reduce.T)

    def misfit(self, logs: Array, target: Array) -> tuple[float, Array]:
        """Minus the log marginal likelihood of the projected residuals, and its derivatives."""
        covariance = self.covariance(logs)
        factor = np.linalg.cholesky(np.eye(len(target)) + self.projected(covariance))
        inverse = cho_solve((factor, True), np.eye(len(target)))
        solved = inverse @ target
        value = 0.5 * target @ solved + np.log(np.diag(factor)).sum()
        weight = self._reduce.T @ (inverse - np.outer(solved, solved)) @ self._reduce
        terms = 0.5 * weight * covariance
        by_coordinate = self._own.T @ terms.sum(axis=1)
        gradient = np.r_[
            2.0 * by_coordinate,
            np.sum(terms * self._flexion) * np.exp(-2 * logs[-2]),
            np.sum(terms * self._load) * np.exp(-2 * logs[-1]),
        ]
        return float(value), gradient
