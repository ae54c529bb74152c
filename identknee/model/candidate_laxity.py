"""Candidate laxity trials, as predicted by the model of the knee."""

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from identknee.laxity.protocol import (
    FLEXION_DEG,
    SAME_ANGLE_DEG,
    UNLOADED,
    Protocol,
    candidate_trials,
    concatenate,
    from_zero,
    zero_of_added_trials,
)
from identknee.laxity.table import COORDINATES, Laxity
from identknee.mechanics.pose import pose_from_coordinates
from identknee.model.laxity_model import LaxityModel
from identknee.model.mechanics_inputs import POSE_EVERY_DEG
from identknee.model.parameters import FreeParameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import declared, entry

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the loads, one after the other


def continued_from_own_poses(model: LaxityModel, theta: Array) -> LaxityModel:
    """The model started from its own equilibria at theta, continued under increasing loads.

    Equilibria are followed from the poses of the model under a growing share of the loads. A trial
    that has no equilibrium under some share goes on from where it was.

    Parameters
    ----------
    model
        A model with poses; one whose paths begin in the scanned pose is given back as it is.
    theta
        Its parameters, shape ``(p,)``.
    """
    if model.poses is None:
        return model
    for share in SHARES:
        part = model.protocol.under(np.full(model.protocol.n, share))
        found = replace(model, protocol=part).predict(theta, derivatives=False)
        has_pose = found.is_converged[:, None]
        poses = pose_from_coordinates(np.where(has_pose, found.coordinates, 0.0))
        model = replace(model, poses=np.where(has_pose, poses, model.poses))
    return model


@declared
class CandidateLaxity:
    """Candidate trials, measured like those of the data.

    A trial that is added has the coordinates that the data have, counted from the same zero, with
    the errors `sd` and the correlation within a trial that the data state.

    Raises
    ------
    ValueError
        If no coordinate would be measured, or a standard deviation is not positive.
    """

    model: LaxityModel = entry("The model of the data")
    laxity: Laxity = entry("The data")
    protocol: Protocol = entry("The trials to choose from")
    sd: Array = entry(
        "Standard deviation of each coordinate of an added trial [mm, deg], shape ``(5,)``; "
        "NaN for those that would not be measured. See `typical_errors`"
    )
    free: FreeParameters = entry(
        "The parameters of the model that vary, and the values of the others"
    )
    _whitening: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sd", frozen(self.sd, len(COORDINATES), name="sd"))
        sd = self.sd[~np.isnan(self.sd)]
        if not sd.size:
            raise ValueError("an added trial must measure at least one coordinate")
        if not (sd > 0).all():
            raise ValueError(f"a standard deviation must be greater than 0, got {sd.min():g}")
        shared = np.full((sd.size, sd.size), self.laxity.within_trial_correlation)
        np.fill_diagonal(shared, 1.0)
        whitening = np.linalg.inv(np.linalg.cholesky(sd[:, None] * shared * sd))
        object.__setattr__(self, "_whitening", whitening)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the k trials."""
        return self.protocol.trials

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """What the chosen trials would measure at `theta`, and its derivatives by theta.

        In units of the errors, with their correlation taken out: shapes ``(k, m)`` and ``(k, m,
        n)`` for m measured coordinates; NaN in all of a trial that did not converge or in which
        contact acts within 3 mm of a rim, or whose unloaded pose is such a one where coordinates
        are counted from it. A trial may come twice.
        """
        once, back = np.unique(np.asarray(chosen, int), return_inverse=True)
        some = replace(self, protocol=self.protocol.select(once))
        found = self.model.with_protocol(some.trials).predict(self.free.expand(theta))
        if found.jacobian is None:  # pragma: no cover - predict was asked for it
            raise AssertionError
        # A trial that presses near a rim is not worth making: there are others to choose from.
        lost = (found.rim_share > 0.0)[:, None, None]
        coordinates = np.where(lost, np.nan, found.coordinates[:, :, None])
        slopes = np.where(lost, np.nan, self.free.restrict(found.jacobian))
        return some.rows(coordinates)[back, :, 0], some.rows(slopes)[back]

    @property
    def trials(self) -> Protocol:
        """The candidates, followed by the trials that define their zero."""
        is_counted = zero_of_added_trials(self.laxity.zero) == UNLOADED
        return with_unloaded(self.protocol) if is_counted else self.protocol

    def with_start_poses(self, theta: Array) -> "CandidateLaxity":
        """The same candidates; unmeasured ones start at the poses predicted at `theta`.

        These are followed under growing loads from between the poses of the data. `theta` is that
        of `predict`.
        """
        model = self.model.with_protocol(self.trials)
        if model.poses is None:
            return self
        own = continued_from_own_poses(model, self.free.expand(theta))
        if own.poses is None:  # pragma: no cover - only its numbers are others
            raise AssertionError
        is_made = np.isin(self.trials.trials, self.laxity.protocol.trials)[:, None]
        poses = np.where(is_made, model.poses, own.poses)
        return replace(self, model=replace(own, poses=poses))

    def rows(self, changes: Array) -> Array:
        """Changes of the coordinates of `trials` (n, 5, q) in units of the errors, (k, m, q)."""
        changes = from_zero(changes, self.trials, zero_of_added_trials(self.laxity.zero))
        measured = changes[: self.protocol.n, ~np.isnan(self.sd)]
        return np.asarray(self._whitening @ measured)


def offered_laxity(model: LaxityModel, made: Protocol) -> Protocol:
    """Candidate trials: `candidate_trials` at the flexion angles of the model.

    Where it begins at poses, these are the angles among or close to those of the trials made.
    """
    if model.poses is None:
        return candidate_trials(made)
    angles = np.array(FLEXION_DEG)
    apart = np.maximum(made.flexion_deg.min() - angles, angles - made.flexion_deg.max())
    return candidate_trials(made, angles[apart <= 0.5 * POSE_EVERY_DEG].tolist())


def typical_errors(laxity: Laxity) -> Array:
    """The median stated error of each coordinate [mm, deg], ``(5,)``; NaN for those not measured.

    Raises
    ------
    ValueError
        If the laxity states no errors.
    """
    if laxity.sd is None:
        raise ValueError("the laxity states no standard deviations; give those of the added trials")
    return np.array(
        [
            np.median(sd[measured]) if measured.any() else np.nan
            for sd, measured in zip(laxity.sd.T, laxity.is_measured.T, strict=True)
        ]
    )


def with_unloaded(protocol: Protocol) -> Protocol:
    """The protocol with an unloaded trial at each flexion angle that lacks one, added at its end.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> with_unloaded(load_protocol("seed63").select([0, 1])).trials[2:]
    ('unloaded at 0',)
    """
    has = protocol.flexion_deg[protocol.is_unloaded]
    missing: list[float] = []
    for angle in protocol.flexion_deg:
        if not (np.abs(np.array([*has, *missing]) - angle) <= SAME_ANGLE_DEG).any():
            missing.append(float(angle))
    if not missing:
        return protocol
    added = Protocol(
        name="unloaded",
        trials=tuple(f"unloaded at {angle!r}".removesuffix(".0") for angle in missing),
        flexion_deg=np.array(missing),
        loads=np.zeros((len(missing), protocol.loads.shape[1])),
        state=None if protocol.state is None else protocol.state[:1] * len(missing),
    )
    return concatenate([protocol, added], name=protocol.name)
