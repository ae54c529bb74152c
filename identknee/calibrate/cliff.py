"""A way on from a cliff, the boundary of the region in which the model has a prediction."""

import numpy as np
import scipy.linalg

from identknee.calibrate.evaluation import Evaluator
from identknee.calibrate.scales import typical_steps
from identknee.calibrate.tolerances import RANK_TOLERANCE
from identknee.runs.arrays import Array

LENGTHS = (1.0, 1 / 4, 1 / 16, 1 / 64)
LONGEST = 5.0
TILTS_DEG = (50.0, 75.0, 85.0)
TILTED_LENGTHS = (1.0, 0.1, 0.01)
# Least share of the decrease that the linear model, which sees no cliff, promises.
ENOUGH = 0.01


def way_around(evaluator: Evaluator, theta: Array, generator: np.random.Generator) -> Array | None:
    """A feasible point clearly lower than `theta`, shape ``(n,)``; None if there is none.

    The singular vectors of the Jacobian turn the deviance into the distance from a target. First
    the components of the way to the target are tried one by one: where stiff and soft directions
    are mixed, often some of them are free. If all are blocked, the way itself is tilted sideways,
    along each of the directions across it and then away from those that were blocked, which
    slides along the cliff.

    Parameters
    ----------
    evaluator
        Evaluator of the residuals; it has a prediction at `theta`.
    theta
        A point before a cliff, shape ``(n,)``, within the bounds.
    generator
        Turns the sideways directions, so that a second try differs from the first.
    """
    poll = _Poll(evaluator, theta)
    if poll.distance == 0.0:
        return None
    for length in LENGTHS:
        steps = length * np.diag(poll.target)
        lower = poll.lowest(steps[np.argsort(-np.abs(poll.target))])
        if lower is not None:
            return lower
    across = _across(poll.target, generator)
    for length in TILTED_LENGTHS:
        for tilt in np.deg2rad(TILTS_DEG):
            lower = _slide(poll, across, float(tilt), length)
            if lower is not None:
                return lower
    return None


class _Poll:
    """Trial steps from one point, in coordinates where the linear model is a distance."""

    def __init__(self, evaluator: Evaluator, theta: Array) -> None:
        self._evaluator = evaluator
        self._theta = theta
        self._scales = typical_steps(evaluator.parameters)
        here = evaluator(theta)
        left, size, right = scipy.linalg.svd(here.jacobian * self._scales, full_matrices=False)
        kept = size > RANK_TOLERANCE * size[0]
        self._scaled_from_poll = right[kept].T / size[kept]
        self._deviance = here.deviance
        self.target: Array = -(left[:, kept].T @ here.residuals)
        self.distance = float(np.linalg.norm(self.target))

    def lowest(self, steps: Array) -> Array | None:
        """The lowest point after any of the `steps`, None where none is low enough."""
        tried = [self.after(step) for step in steps]
        deviance, point = min(tried, key=lambda pair: pair[0])
        return point if self.is_lower(deviance) else None

    def after(self, step: Array) -> tuple[float, Array]:
        """Deviance after `step`, and the point, kept to bounds and to moderate lengths."""
        scaled = self._scaled_from_poll @ step
        length = float(np.max(np.abs(scaled)))
        parameters = self._evaluator.parameters
        point = np.clip(
            self._theta + self._scales * scaled * min(1.0, LONGEST / max(length, LONGEST)),
            parameters.lower,
            parameters.upper,
        )
        return self._evaluator.deviance(point), point

    def is_lower(self, deviance: float) -> bool:
        """Whether the decrease is worth the step."""
        return deviance < self._deviance - ENOUGH * self.distance**2


def _slide(poll: _Poll, across: Array, tilt: float, length: float) -> Array | None:
    """The lowest point along the way to the target, tilted sideways by an angle [rad]."""
    toward = np.cos(tilt) * poll.target
    sideways = np.sin(tilt) * poll.distance
    reach = length * np.cos(tilt)
    blocked = np.zeros(poll.target.size)
    for direction in np.vstack([across, -across]):
        deviance, point = poll.after(reach * (toward + sideways * direction))
        if poll.is_lower(deviance):
            return point
        blocked += direction * (not np.isfinite(deviance))
    if not blocked.any():
        return None
    away = -blocked / np.linalg.norm(blocked)
    return poll.lowest((reach * (toward + sideways * away))[None])


def _across(target: Array, generator: np.random.Generator) -> Array:
    """Orthonormal directions across `target`, as rows, turned at random."""
    basis = scipy.linalg.null_space(target[None])
    turn, _ = np.linalg.qr(generator.standard_normal((basis.shape[1], basis.shape[1])))
    return np.asarray((basis @ turn).T)
