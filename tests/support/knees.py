"""Knees and models for the measured rows, and the model's energy at any pose."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from energy_evaluation import point_at

from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity
from identknee.mechanics.energy import evaluate
from identknee.mechanics.equilibria import workspace
from identknee.mechanics.memory import N_TOUCHING, ROTATION_SCALE
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array
from identknee.subject.folder import example
from identknee.subject.knee import Knee

SCALE = np.array([ROTATION_SCALE, ROTATION_SCALE, 1.0, 1.0, 1.0])
DEFAULT: Any = LaxityModel.__dataclass_fields__["n_points"].default


def knee(name: str) -> Knee:
    """The named subject called `name`."""
    return example(name)


def model(name: str, n_points: int | None = DEFAULT) -> LaxityModel:
    """The model of a knee under the 63 trials."""
    return LaxityModel(knee=knee(name), protocol=load_protocol("seed63"), n_points=n_points)


def noise_free(of: LaxityModel) -> LaxityResiduals:
    """The calibration problem of fitting a model to its own laxity."""
    return LaxityResiduals(model=of, laxity=own_laxity(of))


def own_laxity(of: LaxityModel) -> Laxity:
    """The laxity at the subject's own parameters."""
    return of.simulate(of.parameters.center)


def mean_errors(theta: Array, parameters: Parameters) -> tuple[float, float]:
    """Mean absolute error of the stiffnesses [kN] and of the reference strains [%]."""
    error = np.abs(theta - parameters.center)
    m = parameters.n // 2
    return float(error[:m].mean()), float(error[m:].mean())


def anywhere(parameters: Parameters, n: int, generator: np.random.Generator) -> Array:
    """Parameter vectors from the whole box, shape ``(n, p)``."""
    return generator.uniform(parameters.lower, parameters.upper, size=(n, parameters.n))


@dataclass(frozen=True, kw_only=True)
class PoseEnergy:
    """The energy of one trial at one parameter vector, as the kernel evaluates it.

    Poses here are in mm throughout: angles [rad] times 40 mm, as are the derivatives.
    """

    model: LaxityModel
    theta: Array
    flexion: float
    load: Array
    _work: Any = field(init=False, repr=False)
    _arrays: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        m = len(self.theta) // 2
        joint = self.model.joint
        arrays = (
            joint.contact.arrays(),
            joint.field.arrays(),
            joint.lines.arrays(self.theta[:m] * 1000.0, self.theta[m:] * 0.01),
        )
        object.__setattr__(self, "_arrays", arrays)
        object.__setattr__(self, "_work", workspace(len(joint.contact.points)).evaluation)

    def at(self, place: Array) -> tuple[float, Array, Array]:
        """Energy [N mm], gradient [N] and Hessian [N/mm] at a pose in mm."""
        energy, g, H, _ = self.raw(np.asarray(place) / SCALE)
        return energy, g / SCALE, H / SCALE / SCALE[:, None]

    def raw(self, pose: Array) -> tuple[float, Array, Array, Array]:
        """Energy, gradient, Hessian and d gradient / d flexion in the kernel's own units."""
        return self._evaluated(self.flexion, pose, self.load)

    @property
    def n_touching(self) -> int:
        """Contact points that may touch the femur at the pose evaluated last."""
        return int(self._work.placed.counts[N_TOUCHING])

    def loaded(self, flexion: float, load: Array) -> Callable[[Array], tuple[float, Array, Array]]:
        """`at` under another flexion and load, sharing this one's memory."""

        def at(place: Array) -> tuple[float, Array, Array]:
            energy, g, H, _ = self._evaluated(flexion, np.asarray(place) / SCALE, load)
            return energy, g / SCALE, H / SCALE / SCALE[:, None]

        return at

    def _evaluated(
        self, flexion: float, pose: Array, load: Array
    ) -> tuple[float, Array, Array, Array]:
        at = point_at(pose)
        energy = evaluate(flexion, load, *self._arrays, self._work, at)
        return float(energy), at.gradient, at.hessian, at.gradient_by_flexion


def trial_energy(of: LaxityModel, theta: Array, trial: int) -> PoseEnergy:
    """The energy of one trial of the model's protocol."""
    node = of.paths.trial_node[trial]
    return PoseEnergy(
        model=of,
        theta=np.asarray(theta, float),
        flexion=float(of.paths.flexion[node]),
        load=of.paths.loads[node],
    )
