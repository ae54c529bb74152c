"""How effects change what a model predicts, and how that changes with their amplitudes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identknee.mechanics.equilibria import Equilibria
from identknee.model.effects.effect import Effect, MechanicalEffect, ObservationEffect, Tests
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

    @property
    def parameters(self) -> Parameters | None:
        """Amplitudes of all effects; None where there is none."""
        return joined([x.parameters for x in self.effects]) if self.effects else None

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with all effects at amplitudes `values`."""
        for effect, part in zip(self.effects, self._parts(values), strict=True):
            if isinstance(effect, MechanicalEffect):
                setting = effect.change(setting, part)
        return setting

    def observe(self, coordinates: Array, values: Array, tests: Tests) -> Array:
        """What is measured of coordinates, shape ``(n, 5)``."""
        for effect, part in zip(self.effects, self._parts(values), strict=True):
            if isinstance(effect, ObservationEffect):
                coordinates = effect.observe(coordinates, part, tests)
        return coordinates

    def pose_columns(
        self, unchanged: Setting, values: Array, found: Equilibria, nodes: IntArray
    ) -> Array:
        """Derivatives of the poses by the amplitudes, shape ``(n, 5, a)``.

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
        columns = np.empty((len(nodes), 5, len(values)))
        for k, move in enumerate(self.moves()):
            low, high = (self.change(unchanged, values + s * move) for s in (-1.0, 1.0))
            columns[:, :, k] = -self._gradient_change(low, high, flexion, found, nodes)
            columns[:, :, k] /= 2.0 * move[k]
        return np.asarray(np.linalg.solve(found.hessians[nodes], columns))

    def observed_slopes(
        self, coordinates: Array, values: Array, tests: Tests
    ) -> tuple[Array, Array]:
        """Derivatives of what is measured, by coordinates (n, 5, 5) and amplitudes (n, 5, a)."""
        by_coordinate = np.broadcast_to(np.eye(5), (len(coordinates), 5, 5))
        by_amplitude = np.zeros((len(coordinates), 5, len(values)))
        if not any(isinstance(x, ObservationEffect) for x in self.effects):
            return by_coordinate, by_amplitude
        by_coordinate = np.empty(by_coordinate.shape)
        for j, move in enumerate(COORDINATE_STEP * np.eye(5)):
            seen = [self.observe(coordinates + s * move, values, tests) for s in (-1.0, 1.0)]
            by_coordinate[:, :, j] = (seen[1] - seen[0]) / (2.0 * COORDINATE_STEP)
        for k, move in enumerate(self.moves()):
            seen = [self.observe(coordinates, values + s * move, tests) for s in (-1.0, 1.0)]
            by_amplitude[:, :, k] = (seen[1] - seen[0]) / (2.0 * move[k])
        return by_coordinate, by_amplitude

    def moves(self) -> Array:
        """A small change of each amplitude alone, shape ``(a, a)``."""
        parameters = self.parameters
        if parameters is None:
            return np.zeros((0, 0))
        return np.diag(STEP * (parameters.upper - parameters.lower))

    def _gradient_change(
        self, low: Setting, high: Setting, flexion: Array, found: Equilibria, nodes: IntArray
    ) -> Array:
        """Change of the energy's gradient at fixed poses from one setting to another, (n, 5)."""
        poses, m = found.poses[nodes], low.stiffness.size
        change = low.loads[nodes] - high.loads[nodes]
        if high.lines is not low.lines or high.stiffness is not low.stiffness:
            change = change + high.line_gradient(flexion, poses) - low.line_gradient(flexion, poses)
        change = change + found.flexed[nodes] * (high.flexion - low.flexion)[nodes][:, None]
        law = np.array(
            [np.log(high.law.modulus / low.law.modulus), high.law.exponent - low.law.exponent]
        )
        if law.any():
            # The sensitivities are -H^-1 times the columns that are wanted here.
            shift = found.sensitivities[nodes][:, :, 2 * m :] @ law
            change = change - np.einsum("nij,nj->ni", found.hessians[nodes], shift)
        return change

    def _parts(self, values: Array) -> list[Array]:
        ends = np.cumsum([x.parameters.n for x in self.effects])
        return np.split(np.asarray(values, float), ends[:-1]) if len(ends) else []


def joined(parts: Sequence[Parameters]) -> Parameters:
    """Parameters of several parts, one after the other."""
    return Parameters(
        names=tuple(name for x in parts for name in x.names),
        center=np.concatenate([x.center for x in parts]),
        lower=np.concatenate([x.lower for x in parts]),
        upper=np.concatenate([x.upper for x in parts]),
        prior_sd=np.concatenate([x.prior_sd for x in parts]),
        is_log=tuple(flag for x in parts for flag in x.is_log),
    )
