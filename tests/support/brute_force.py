"""Profile deviances and interval ends by brute force: many starts of another program's fits."""

from dataclasses import dataclass

import numpy as np
import scipy.optimize

from identknee.calibrate.problem import Problem, restricted
from identknee.runs.declare import Array


@dataclass(frozen=True, kw_only=True)
class Lowest:
    """The lowest deviance found, and where."""

    deviance: float
    theta: Array


def lowest(problem: Problem, index: int, value: float, starts: Array) -> Lowest:
    """Least deviance with one parameter held, over fits from all `starts`, shape ``(k, n)``."""
    parameters = problem.parameters
    best = Lowest(deviance=np.inf, theta=np.array(starts[0]))
    for start in starts:
        at = np.clip(start, parameters.lower, parameters.upper)
        at[index] = value
        if parameters.n > 1:
            part = restricted(problem, [parameters.names[index]], at)
            at = part.free.expand(_fitted(part, part.free.restrict(at)))
        found = deviance(problem, at)
        if found < best.deviance:
            best = Lowest(deviance=found, theta=at)
    return best


def deviance(problem: Problem, theta: Array) -> float:
    """Sum of squared residuals, infinite without a prediction."""
    residuals = problem.residuals(theta)
    return float(residuals @ residuals) if np.isfinite(residuals).all() else np.inf


def _fitted(problem: Problem, start: Array) -> Array:
    """scipy's reflective trust region, then its dogbox, which ends on bounds."""
    parameters = problem.parameters
    theta = start
    if not np.isfinite(problem.residuals(theta)).all():
        return theta
    for method in ("trf", "dogbox"):
        low, high = parameters.lower, parameters.upper
        margin = 1e-12 * np.maximum(1.0, np.abs(theta)) if method == "trf" else 0.0
        inside = np.minimum(np.maximum(theta, low + margin), high - margin)
        if not np.isfinite(problem.residuals(inside)).all():
            continue
        with np.errstate(all="ignore"):
            found = scipy.optimize.least_squares(
                problem.residuals,
                inside,
                jac=problem.jacobian,
                bounds=(low, high),
                method=method,
                x_scale="jac",
                xtol=1e-14,
                ftol=1e-14,
                gtol=1e-14,
                max_nfev=200,
            )
        if 2 * found.cost <= deviance(problem, theta):
            theta = np.clip(found.x, low, high)
    return theta


class BruteForceProfile:
    """The lowest deviance at each value of one parameter, from many starts each time.

    Starts are the best fit, the best fits at the values asked about before, and random places
    around the best fit.
    """

    def __init__(self, problem: Problem, index: int, optimum: Array, n_random: int = 4) -> None:
        self._problem, self._index, self._optimum = problem, index, optimum
        self._n_random = n_random
        self._generator = np.random.default_rng(index)
        self._found: list[Lowest] = []
        self._floor = deviance(problem, optimum)

    def rise(self, value: float) -> float:
        """How far the lowest deviance at `value` lies above that of the best fit."""
        near = sorted(self._found, key=lambda x: abs(x.theta[self._index] - value))
        starts = [self._optimum, *(x.theta for x in near[:2]), *self._around(self._n_random)]
        self._found.append(lowest(self._problem, self._index, value, np.array(starts)))
        return self._found[-1].deviance - self._floor

    def lower_at(self, value: float, n_starts: int) -> float:
        """How much lower the deviance at `value` is from `n_starts` other random places."""
        before = self.rise(value)
        found = lowest(self._problem, self._index, value, self._around(n_starts))
        return before + self._floor - found.deviance

    def end(self, direction: int, step: float, threshold: float) -> float:
        """Where the rise first exceeds the threshold on one side; infinite if it does not.

        Steps from the best fit to the other side of the end, then Brent's bracketing.
        """
        parameters = self._problem.parameters
        bounds = parameters.lower, parameters.upper
        bound = float(bounds[1 if direction > 0 else 0][self._index])
        inside = float(self._optimum[self._index])
        while inside != bound:
            outside = inside + direction * step
            outside = min(outside, bound) if direction > 0 else max(outside, bound)
            if self.rise(outside) > threshold:
                return float(
                    scipy.optimize.brentq(
                        # Capped, so that a place without prediction is a number too.
                        lambda value: min(self.rise(value) - threshold, threshold),
                        inside,
                        outside,
                        xtol=1e-6 * step,
                    )
                )
            inside = outside
        return direction * np.inf

    def _around(self, n: int) -> Array:
        parameters = self._problem.parameters
        steps = parameters.prior_sd * self._generator.normal(size=(n, parameters.n))
        is_log = np.array(parameters.is_log)
        moved = np.where(is_log, self._optimum * np.exp(steps), self._optimum + steps)
        return np.asarray(np.clip(moved, parameters.lower, parameters.upper))
