"""How effects change what a model predicts, and how that changes with their amplitudes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from identknee.mechanics.memory import CONVERGED, Equilibria
from identknee.model.effects.effect import (
    Effect,
    MechanicalEffect,
    ObservationEffect,
    Tests,
    is_read_in_copies,
)
from identknee.model.gradient_change import gradient_columns, low_and_high
from identknee.model.parameters import Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array, IntArray

# Of the range of an amplitude: settings and observations are smooth functions in closed form, whose
# central difference is right to the square of this.
STEP = 1e-6
COORDINATE_STEP = 1e-4  # mm, deg


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Extension:
    """The effects of a model, and where their amplitudes stand in a vector of all of them.

    Attributes
    ----------
    effects
        In the order in which they act.
    """

    effects: tuple[Effect, ...]
    _mechanical: tuple[tuple[MechanicalEffect, slice], ...] = field(init=False, repr=False)
    _observed: tuple[tuple[ObservationEffect, slice], ...] = field(init=False, repr=False)
    _steps: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        ends = np.cumsum([0, *(x.parameters.n for x in self.effects)]).tolist()
        parts = [slice(*x) for x in pairwise(ends)]
        placed = list(zip(self.effects, parts, strict=True))
        mechanical = tuple((x, part) for x, part in placed if isinstance(x, MechanicalEffect))
        observed = tuple((x, part) for x, part in placed if isinstance(x, ObservationEffect))
        ranges = [x.parameters.upper - x.parameters.lower for x in self.effects]
        object.__setattr__(self, "_steps", STEP * np.concatenate([np.zeros(0), *ranges]))
        object.__setattr__(self, "_mechanical", mechanical)
        object.__setattr__(self, "_observed", observed)

    @property
    def parameters(self) -> Parameters | None:
        """Amplitudes of all effects; None where there is none."""
        return joined([x.parameters for x in self.effects]) if self.effects else None

    def changes(self, setting: Setting, values: Array) -> list[Setting]:
        """The setting, then with one effect more each time, all at amplitudes `values`."""
        settings = [setting]
        for effect, part in self._mechanical:
            settings.append(effect.change(settings[-1], values[part]))
        return settings

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with all effects at amplitudes `values`."""
        return self.changes(setting, values)[-1]

    def observe(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """What is measured of coordinates, shape ``(n, 5)``."""
        for effect, part in self._observed:
            coordinates = effect.observe(coordinates, values[part], tests)
        return coordinates

    def pose_columns(
        self, settings: Sequence[Setting], values: Array, found: Equilibria, nodes: IntArray
    ) -> Array:
        """Derivatives of the poses by the amplitudes, shape ``(n, 5, a)``; NaN without a pose.

        Parameters
        ----------
        settings
            Those of `changes`, at the nodes of the load paths.
        values
            Amplitudes, shape ``(a,)``.
        found
            The equilibria at the nodes, made under a stated contact law.
        nodes
            The node of each trial, shape ``(n,)``.
        """
        columns = -gradient_columns(self._mechanical, settings, values, self._steps, found, nodes)
        # Where no equilibrium was found the Hessian may be singular.
        has_pose = found.codes[nodes] == CONVERGED
        columns[~has_pose] = np.nan
        # Inverting matrices so small takes a third of the time that solving with them does.
        columns[has_pose] = np.linalg.inv(found.hessians[nodes][has_pose]) @ columns[has_pose]
        return columns

    def observed_slopes(
        self, coordinates: Array, values: Array, tests: Tests
    ) -> tuple[Array, Array]:
        """Derivatives of what is measured, by coordinates (n, 5, 5) and amplitudes (n, 5, a)."""
        if not self._observed:
            by_coordinate = np.broadcast_to(np.eye(5), (len(coordinates), 5, 5))
            return by_coordinate, np.zeros((len(coordinates), 5, len(values)))
        # Readings with one number a little smaller and larger, all below each other: they go
        # through the effects that act later together.
        n, moved = len(coordinates), [*range(5)]
        steps = np.r_[np.full(5, COORDINATE_STEP), self._steps]
        stack = (coordinates + low_and_high(np.zeros(5), steps[:5])[:, None]).reshape(-1, 5)
        for effect, part in self._observed:
            stack = effect.observe(stack, values[part], tests.repeated(len(stack) // n))
            each = low_and_high(values[part], self._steps[part])
            stack = np.concatenate([stack, _readings(effect, coordinates, each, tests)])
            coordinates = effect.observe(coordinates, values[part], tests)
            moved += range(5 + part.start, 5 + part.stop)
        low, high = np.moveaxis(stack.reshape(-1, 2, n, 5), 1, 0)
        slopes = np.zeros((n, 5, 5 + len(values)))
        slopes[:, :, moved] = np.moveaxis(high - low, 0, 2) / (2.0 * steps[moved])
        return slopes[:, :, :5], slopes[:, :, 5:]

    def moves(self) -> Array:
        """A small change of each amplitude alone, shape ``(a, a)``."""
        return np.diag(self._steps)


def _readings(effect: ObservationEffect, coordinates: Array, each: Array, tests: Tests) -> Array:
    """What is measured at amplitudes of `each` row (k, a), below each other, ``(k n, 5)``."""
    k = len(each)
    if k and is_read_in_copies(effect):
        return effect.observe_copies(np.tile(coordinates, (k, 1)), each, tests.repeated(k))
    return np.concatenate([coordinates[:0], *(effect.observe(coordinates, x, tests) for x in each)])


def joined(parts: Sequence[Parameters]) -> Parameters:
    """Parameters of several parts, one after the other."""
    return Parameters(
        names=tuple(name for x in parts for name in x.names),
        center=np.concatenate([x.center for x in parts]),
        lower=np.concatenate([x.lower for x in parts]),
        upper=np.concatenate([x.upper for x in parts]),
        prior_sd=np.concatenate([x.prior_sd for x in parts]),
        is_log=np.concatenate([x.is_log for x in parts]),
        is_nuisance=np.concatenate([~x.is_of_interest for x in parts]),
        own=None if all(x.own is None for x in parts) else np.concatenate([x.start for x in parts]),
    )
