"""A trial's load path followed in small steps by an independent minimiser."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from knees import SCALE, PoseEnergy
from scipy.optimize import minimize

from identknee.runs.declare import Array

LOAD_STEP = 100.0 / SCALE[0]  # N: 0.1 N m over the rotation scale
FLEXION_STEP = float(np.radians(0.5))
# A step that moves the tibia farther than this [mm, angles times 40 mm] is tried again at half its
# length; one that does so however short has left the branch.
LARGEST_MOVE = 0.1
MOST_HALVINGS = 10
TOLERANCE = 1e-5  # N
LEAST_STIFFNESS = 1e-3  # N/mm; a pose less stiff than this is not unique
MOST_STEPS = 20_000

Function = Callable[[Array], tuple[float, Array, Array]]


@dataclass(frozen=True, kw_only=True)
class End:
    """How far along its path a trial got (1 the unloaded knee in flexion, 2 the full load), why
    not farther, and its pose in mm under the full load or the length of the jump there [mm].
    """

    reached: float
    reason: str
    place: Array | None = None
    jump: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SideWalk:
    """A straight piece of the path, from one flexion [rad] and load to another."""

    flexion: tuple[float, float]
    load: tuple[Array, Array]

    @property
    def step(self) -> float:
        """Share of the leg that one full step is."""
        size = abs(self.flexion[1] - self.flexion[0]) / FLEXION_STEP
        size += float(np.linalg.norm((self.load[1] - self.load[0]) / SCALE)) / LOAD_STEP
        return 1.0 / max(float(size), 1.0)

    def at(self, share: float) -> tuple[float, Array]:
        """Flexion and load after a share of the leg."""
        return (
            self.flexion[0] + share * (self.flexion[1] - self.flexion[0]),
            self.load[0] + share * (self.load[1] - self.load[0]),
        )


def follow_slowly(energy: PoseEnergy) -> End:
    """Follow the unloaded knee through flexion, then the load, as far as the branch goes."""
    joint = energy.model.joint
    none = np.zeros(5)
    legs = (
        SideWalk(flexion=(joint.start_flexion, energy.flexion), load=(none, none)),
        SideWalk(flexion=(energy.flexion, energy.flexion), load=(none, energy.load)),
    )
    place = _minimum(energy.loaded(joint.start_flexion, none), joint.start * SCALE, radius=0.5)
    if place is None:
        return End(reached=0.0, reason="no unique pose at the start")
    for index, leg in enumerate(legs):
        place, end = _follow(energy, leg, place)
        if place is None:
            return replace(end, reached=index + end.reached)
    return End(reached=2.0, reason="reached the full load", place=place)


def _follow(energy: PoseEnergy, leg: SideWalk, place: Array) -> tuple[Array | None, End]:
    reached, step, halvings = 0.0, leg.step, 0
    for _ in range(MOST_STEPS):
        if reached >= 1.0:
            return place, End(reached=1.0, reason="")
        goal = min(1.0, reached + step)
        found = _minimum(energy.loaded(*leg.at(goal)), place, radius=0.05)
        move = np.inf if found is None else float(np.linalg.norm(found - place))
        if found is not None and move <= LARGEST_MOVE:
            place, reached = found, goal
            if halvings:
                step, halvings = 2.0 * step, halvings - 1
        elif halvings < MOST_HALVINGS:
            step, halvings = 0.5 * step, halvings + 1
        elif found is None:
            return None, End(reached=reached, reason="no unique pose")
        else:
            return None, End(reached=reached, reason="the pose jumps", jump=move)
    return None, End(reached=reached, reason="too many steps")


def _minimum(function: Function, start: Array, radius: float) -> Array | None:
    """The minimum of a basin, None where there is none or it is not stiff enough to be unique."""
    seen: dict[bytes, tuple[float, Array, Array]] = {}

    def known(place: Array) -> tuple[float, Array, Array]:
        key = place.tobytes()
        if key not in seen:
            seen.clear()
            seen[key] = function(place)
        return seen[key]

    end = minimize(
        lambda x: known(x)[0],
        start,
        jac=lambda x: known(x)[1],
        hess=lambda x: known(x)[2],
        method="trust-exact",
        options={"gtol": 1e-4, "initial_trust_radius": radius, "max_trust_radius": 6.0 * radius},
    )
    place = np.asarray(end.x)
    # The energy's rounding hides what the gradient still shows: two plain Newton steps.
    for _ in range(2):
        _, gradient, hessian = function(place)
        if np.linalg.eigvalsh(hessian)[0] < LEAST_STIFFNESS:
            return None
        place = place - np.linalg.solve(hessian, gradient)
    return place if np.linalg.norm(function(place)[1]) <= TOLERANCE else None
