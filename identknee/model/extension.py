"""How effects change what a model predicts, and how that changes with their amplitudes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from identknee.mechanics.kernel import CONVERGED
from identknee.mechanics.memory import Equilibria
from identknee.model.effects.effect import (
    Effect,
    MechanicalEffect,
    ObservationEffect,
    SelfContainedEffect,
    Tests,
)
from identknee.model.gradient_change import gradient_changes
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

    def __post_init__(self) -> None:
        ends = np.cumsum([0, *(x.parameters.n for x in self.effects)]).tolist()
        parts = [slice(*x) for x in pairwise(ends)]
        placed = list(zip(self.effects, parts, strict=True))
        mechanical = tuple((x, part) for x, part in placed if isinstance(x, MechanicalEffect))
        observed = tuple((x, part) for x, part in placed if isinstance(x, ObservationEffect))
        object.__setattr__(self, "_mechanical", mechanical)
        object.__setattr__(self, "_observed", observed)

    @property
    def parameters(self) -> Parameters | None:
        """Amplitudes of all effects; None where there is none."""
        return joined([x.parameters for x in self.effects]) if self.effects else None

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with all effects at amplitudes `values`."""
        for effect, part in self._mechanical:
            setting = effect.change(setting, values[part])
        return setting

    def observe(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """What is measured of coordinates, shape ``(n, 5)``."""
        for effect, part in self._observed:
            coordinates = effect.observe(coordinates, values[part], tests)
        return coordinates

    def pose_columns(
        self, unchanged: Setting, values: Array, found: Equilibria, nodes: IntArray
    ) -> Array:
        """Derivatives of the poses by the amplitudes, shape ``(n, 5, a)``; NaN without a pose.

        Parameters
        ----------
        unchanged
            The setting without effects, at the nodes of the load paths.
        values
            Amplitudes, shape ``(a,)``.
        found
            The equilibria at the nodes, made under a stated contact law.
        nodes
            The node of each trial, shape ``(n,)``.
        """
        flexion = self.change(unchanged, values).flexion[nodes]
        columns = np.zeros((len(nodes), 5, len(values)))
        moves, before = self.moves(), unchanged
        poses = found.poses[nodes]
        for place, (effect, part) in enumerate(self._mechanical):
            if isinstance(effect, SelfContainedEffect):
                own = effect.gradient_columns(before, values[part], flexion, poses)
                columns[:, :, part] = -own
            else:
                pairs = [
                    (self._from(place, before, values - x), self._from(place, before, values + x))
                    for x in moves[part]
                ]
                changes = gradient_changes(pairs, flexion, found, nodes)
                columns[:, :, part] = -changes / (2.0 * np.diag(moves)[part])
            before = effect.change(before, values[part])
        # Where no equilibrium was found the Hessian may be singular.
        has_pose = found.codes[nodes] == CONVERGED
        columns[~has_pose] = np.nan
        columns[has_pose] = np.linalg.solve(found.hessians[nodes][has_pose], columns[has_pose])
        return columns

    def observed_slopes(
        self, coordinates: Array, values: Array, tests: Tests
    ) -> tuple[Array, Array]:
        """Derivatives of what is measured, by coordinates (n, 5, 5) and amplitudes (n, 5, a)."""
        by_coordinate = np.broadcast_to(np.eye(5), (len(coordinates), 5, 5))
        by_amplitude = np.zeros((len(coordinates), 5, len(values)))
        if not self._observed:
            return by_coordinate, by_amplitude
        by_coordinate = np.empty(by_coordinate.shape)
        for j, move in enumerate(COORDINATE_STEP * np.eye(5)):
            seen = [self.observe(coordinates + s * move, values, tests) for s in (-1.0, 1.0)]
            by_coordinate[:, :, j] = (seen[1] - seen[0]) / (2.0 * COORDINATE_STEP)
        moves = self.moves()
        for k in (k for _, part in self._observed for k in range(part.start, part.stop)):
            seen = [self.observe(coordinates, values + s * moves[k], tests) for s in (-1.0, 1.0)]
            by_amplitude[:, :, k] = (seen[1] - seen[0]) / (2.0 * moves[k, k])
        return by_coordinate, by_amplitude

    def moves(self) -> Array:
        """A small change of each amplitude alone, shape ``(a, a)``."""
        parameters = self.parameters
        if parameters is None:
            return np.zeros((0, 0))
        return np.diag(STEP * (parameters.upper - parameters.lower))

    def _from(self, place: int, setting: Setting, values: Array) -> Setting:
        """The setting with the mechanical effects from number `place` on.

        The later ones are left out where that one changes nothing that they act on.
        """
        (effect, part), *later = self._mechanical[place:]
        changed = effect.change(setting, values[part])
        if changed.loads is setting.loads and changed.lines is setting.lines:
            return changed
        for effect, part in later:
            if not isinstance(effect, SelfContainedEffect):
                changed = effect.change(changed, values[part])
        return changed


def joined(parts: Sequence[Parameters]) -> Parameters:
    """Parameters of several parts, one after the other."""
    return Parameters(
        names=tuple(name for x in parts for name in x.names),
        center=np.concatenate([x.center for x in parts]),
        lower=np.concatenate([x.lower for x in parts]),
        upper=np.concatenate([x.upper for x in parts]),
        prior_sd=np.concatenate([x.prior_sd for x in parts]),
        is_log=np.concatenate([x.is_log for x in parts]),
        own=None if all(x.own is None for x in parts) else np.concatenate([x.start for x in parts]),
    )
