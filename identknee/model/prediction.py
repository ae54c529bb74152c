"""What a laxity model predicts at one parameter vector, for all trials."""

from functools import lru_cache
from typing import Any

import numpy as np

from identknee.mechanics.contact_points import RimDistance, rim_force_fraction
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.equilibria import (
    ContactPoints,
    LoadPaths,
    paths_of_release,
    solve,
    stability_margins,
)
from identknee.mechanics.memory import CONVERGED, Equilibria
from identknee.runs.declare import Array, BoolArray, IntArray, declared, entry, short_repr
from identknee.runs.record import Outcome

# Share of the contact force near a rim above which a trial is reported.
NOTEWORTHY_RIM_SHARE = 0.05
# In the order of the kernel's codes.
OUTCOMES = (
    Outcome.CONVERGED,
    Outcome.FOLD,
    Outcome.NO_EQUILIBRIUM,
    Outcome.UNCONSTRAINED,
)


@declared
class Prediction:
    """The prediction of a laxity model at one parameter vector, for n trials and p parameters."""

    theta: Array = entry("The parameter vector, shape ``(p,)``")
    coordinates: Array = entry(
        "Lateral shift, anterior drawer, distraction [mm], varus, internal rotation [deg], shape "
        "``(n, 5)``; NaN where a trial did not converge"
    )
    jacobian: Array | None = entry(
        "Derivatives of the coordinates by theta, shape ``(n, 5, p)``; None if not asked for"
    )
    held_coordinates: Array = entry(
        "Those of the last pose, also without equilibrium; where a search begins at a pose, that "
        "in which a spring holds the knee, shape ``(n, 5)``"
    )
    held_jacobian: Array | None = entry(
        "Their derivatives by theta, shape ``(n, 5, p)``; None with the Jacobian"
    )
    pose_jacobian: Array | None = entry(
        "Derivatives of the pose by theta, shape ``(n, 5, p)``; None with the Jacobian"
    )
    codes: IntArray = entry("How each trial ended, as places in `OUTCOMES`, shape ``(n,)``")
    poses: Array = entry(
        "The last stable pose on the way to each trial: varus, internal [rad], x, y, z [mm], shape "
        "``(n, 5)``"
    )
    hessians: Array | None = entry(
        "Second derivatives of the energy there [N, N mm, N/mm], shape ``(n, 5, 5)``; None for "
        "mesh contact, which has none"
    )
    reached: Array = entry(
        "Share of the last load step that was reached, shape ``(n,)``; NaN where a search that "
        "begins at full load failed"
    )
    released: Array = entry(
        "How far a spring that holds the knee at its measured pose can let go, from 0 to 1, shape "
        "``(n,)``; 0 where trials do not begin at measured poses"
    )
    centres: Array = entry(
        "Contact force of every trial and compartment [N], its centre in tibial and in femoral "
        "axes [mm], shape ``(n, compartments, 7)``"
    )
    menisci: Array = entry(
        "The same of the medial and the lateral meniscus, shape ``(n, 2, 7)``; zero without menisci"
    )
    rims: tuple[RimDistance, tuple[RimDistance, ...]] | None = entry(
        "How far places are from the rims of the femur and of each tibial surface; None for mesh "
        "contact"
    )
    node_poses: Array = entry(
        "Poses at all nodes of the load paths, where another prediction may start"
    )

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for values in (self.theta, self.coordinates, self.codes, self.poses):
            values.flags.writeable = False

    @property
    def slopes(self) -> Array:
        """Derivatives of the coordinates by theta, of a prediction that was asked for them."""
        if self.jacobian is None:  # pragma: no cover - a mistake of the caller
            raise AssertionError
        return self.jacobian

    @property
    def pose_slopes(self) -> Array:
        """Derivatives of the poses by theta.

        Raises
        ------
        ValueError
            If the prediction was made without derivatives.
        """
        if self.pose_jacobian is None:
            raise ValueError("a prediction has derivatives only where they were asked for")
        return self.pose_jacobian

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """How each trial ended."""
        return tuple(OUTCOMES[code] for code in self.codes)

    @property
    def reasons(self) -> tuple[str, ...]:
        """How each trial ended, as sentences."""
        return tuple(
            outcome.sentence
            if converged or np.isnan(reached)
            else f"{outcome.sentence} {100 * reached:.0f} % of the last load step was reached."
            for outcome, converged, reached in zip(
                self.outcomes, self.is_converged, self.reached, strict=True
            )
        )

    @property
    def is_converged(self) -> BoolArray:
        """Which trials have an equilibrium, shape ``(n,)``."""
        return np.asarray(self.codes == CONVERGED)

    @property
    def all_converged(self) -> bool:
        """Whether every trial has an equilibrium."""
        return bool(self.is_converged.all())

    @property
    def rim_share(self) -> Array:
        """Share of each trial's contact force that acts within 3 mm of a rim, shape ``(n,)``.

        NaN for mesh contact. A trial near a rim still has a prediction: without one, the parameters
        would be rejected by the extent of the surfaces and not by the data.
        """
        return _rim_share(self)

    @property
    def is_near_rim(self) -> BoolArray:
        """Which converged trials carry a noteworthy share of contact near a rim, shape ``(n,)``."""
        return np.asarray(self.is_converged & (self.rim_share > NOTEWORTHY_RIM_SHARE))

    @property
    def margins(self) -> Array:
        """Stability margin of each trial's pose [N/mm], shape ``(n,)``.

        The smallest eigenvalue of the Hessian, rotations scaled by 40 mm; NaN for mesh contact.
        """
        if self.hessians is None:
            return np.full(len(self.codes), np.nan)
        return stability_margins(self.hessians)


# Several checks ask for it, and it takes longer than a pose.
@lru_cache(maxsize=2)
def _rim_share(found: Prediction) -> Array:
    if found.rims is None:
        return np.full(len(found.codes), np.nan)
    share = rim_force_fraction(found.centres, *found.rims)
    share.flags.writeable = False
    return share


def solve_beyond_folds(
    paths: LoadPaths,
    start: Array,
    knee: tuple[ContactPoints, DistanceField, Any],
    fallback_poses: Array | None,
    **how: Any,
) -> Equilibria:
    """The equilibria at the nodes of `paths`; beyond folds from each trial's own pose.

    A small error of the geometry may end the path to a trial, or leave the unloaded knee without a
    stable pose, although the measured knee had one. The full load then acts at the trial's own pose
    from the beginning.

    Parameters
    ----------
    paths, start, knee, how
        As for `identknee.mechanics.equilibria.solve`.
    fallback_poses
        Pose of each trial, shape ``(n, 5)``, NaN where unknown; None if no pose is known.
    """
    found = solve(paths, start, *knee, **how)
    if fallback_poses is None:
        return found
    nodes = paths.trial_node
    is_lost = (found.codes[nodes] != CONVERGED) & np.isfinite(fallback_poses).all(axis=1)
    if not is_lost.any():
        return found
    lost = nodes[is_lost]
    at_once = paths_of_release(paths.flexion[lost], paths.loads[lost])
    again = solve(at_once, fallback_poses[is_lost], *knee, **{**how, "guesses": None})
    is_found = again.codes == CONVERGED
    for values, others in zip(found, again, strict=True):
        values[lost[is_found]] = others[is_found]
    return found
