"""Trials that might be added to the data, and the problem with those that were."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from identknee.calibrate.problem import Problem
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array


class Candidates(Protocol):
    """Trials that might be added, as a model predicts them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the k trials, no two alike."""
        ...

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """What the chosen trials would measure at `theta`, and its derivatives by theta.

        In units of the noise, errors independent, shapes ``(k, m)`` and ``(k, m, n)``; NaN in all
        of a trial that has no prediction. A trial may be chosen more than once.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WithTrials:
    """A problem with the residuals of added trials.

    Attributes
    ----------
    problem
        The problem as it was.
    candidates
        Where the added trials come from.
    chosen
        Which of them were added.
    measured
        What they measured, in units of their noise, shape ``(k, m)``.
    """

    problem: Problem
    candidates: Candidates
    chosen: tuple[int, ...]
    measured: Array
    _last: dict[bytes, Array] = field(init=False, repr=False, default_factory=dict)

    @property
    def parameters(self) -> Parameters:
        """Those of the problem."""
        return self.problem.parameters

    def residuals(self, theta: Array) -> Array:
        """Those of the problem, then those of the added trials; all infinite if any is."""
        made = self.problem.residuals(theta)
        values, jacobians = self.candidates.predict(theta, self.chosen)
        added = (values - self.measured).ravel()
        if not (np.isfinite(added).all() and np.isfinite(made).all()):
            return np.full(made.size + added.size, np.inf)
        self._last.clear()
        self._last[theta.tobytes()] = jacobians.reshape(added.size, -1)
        return np.concatenate([made, added])

    def jacobian(self, theta: Array) -> Array:
        """Derivatives of the same, shape ``(m, n)``."""
        added = self._last.get(theta.tobytes())
        if added is None:
            _, jacobians = self.candidates.predict(theta, self.chosen)
            added = jacobians.reshape(self.measured.size, -1)
        return np.vstack([self.problem.jacobian(theta), added])
