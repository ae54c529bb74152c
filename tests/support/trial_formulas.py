"""Trials to choose from whose outcomes are formulas of theta."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from identknee.runs.declare import Array


@dataclass(frozen=True, kw_only=True)
class FormulaTrials:
    """Trial i measures ``values(theta)[i]`` in units of its noise; none where `beyond` is positive.

    `jacobian` has the shape ``(k, m, n)``.
    """

    names: tuple[str, ...]
    values: Callable[[Array], Array]
    jacobian: Callable[[Array], Array]
    beyond: Callable[[int, Array], float] = lambda _, __: -1.0

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        rows = list(chosen)
        values, jacobians = self.values(theta)[rows], self.jacobian(theta)[rows]
        lost = np.array([self.beyond(i, theta) > 0 for i in rows], bool)
        return (
            np.where(lost[:, None], np.nan, values),
            np.where(lost[:, None, None], np.nan, jacobians),
        )


def linear_trials(blocks: Array, **more: Callable[[int, Array], float]) -> FormulaTrials:
    """Trials that measure ``blocks @ theta``, blocks ``(k, m, n)``."""
    return FormulaTrials(
        names=tuple(f"trial {i}" for i in range(len(blocks))),
        values=lambda theta: blocks @ theta,
        jacobian=lambda _: blocks,
        **more,
    )
