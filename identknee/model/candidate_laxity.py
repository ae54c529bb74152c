"""Candidate laxity trials, as predicted by the model of the knee, and steps beside one more trial.

Such steps are a cut and a trial in that state, and forces in a trial.
"""

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from identknee.laxity.experiments import cuts_of
from identknee.laxity.forces import state_with
from identknee.laxity.protocol import (
    FLEXION_DEG,
    LOADS,
    SAME_ANGLE_DEG,
    UNLOADED,
    Protocol,
    candidate_trials,
    concatenate,
    dominant_loads,
    from_zero,
    nominal_flexion,
    nominal_held_loads,
    zero_of_added_trials,
)
from identknee.laxity.table import Laxity
from identknee.mechanics.pose import pose_from_coordinates
from identknee.model.contact_loads import contact_jacobian, contact_values
from identknee.model.experiments import members_of
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import structure_loads, structure_names
from identknee.model.mechanics_inputs import POSE_EVERY_DEG
from identknee.model.parameters import FreeParameters
from identknee.runs.declare import OF_COORDINATE, Array, array, declared, entry

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the loads, in turn


def continued_from_own_poses(model: LaxityModel, theta: Array) -> LaxityModel:
    """The model with its own equilibria at theta as the poses from which searches begin.

    Equilibria are followed from the poses of the model under a growing share of the loads. If a
    trial has no equilibrium under one share, the next begins at its last pose.

    Parameters
    ----------
    model
        A model with poses. A model whose paths begin in the scanned pose is returned unchanged.
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
    sd: Array = array(
        "Standard deviation of each coordinate of an added trial; NaN for those that would not be "
        "measured. See `typical_errors`",
        "coordinate",
        unit=OF_COORDINATE,
    )
    free: FreeParameters = entry(
        "The parameters of the model that vary, and the values of the others"
    )
    _whitening: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
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
        """Predicted coordinates of the chosen trials at `theta`, and their derivatives by theta.

        They are whitened by the errors, with shapes ``(k, m)`` and ``(k, m, n)`` for m measured
        coordinates. NaN for a trial that did not converge or with contact within 3 mm of a rim;
        also if that holds for the unloaded trial from which its coordinates are counted. A trial
        may be chosen twice.
        """
        once, back = np.unique(np.asarray(chosen, int), return_inverse=True)
        some = replace(self, protocol=self.protocol.select(once))
        found = self.model.with_protocol(some.trials).predict(self.free.expand(theta))
        # Contact near a rim is uncertain, and other trials can be chosen instead.
        lost = (found.rim_share > 0.0)[:, None, None]
        coordinates = np.where(lost, np.nan, found.coordinates[:, :, None])
        slopes = np.where(lost, np.nan, self.free.restrict(found.slopes))
        return some.rows(coordinates)[back, :, 0], some.rows(slopes)[back]

    @property
    def trials(self) -> Protocol:
        """The candidates, followed by the trials that define their zero."""
        is_counted = zero_of_added_trials(self.laxity.zero) == UNLOADED
        return with_unloaded(self.protocol) if is_counted else self.protocol

    def with_start_poses(self, theta: Array) -> "CandidateLaxity":
        """The same candidates, with searches of new trials begun at poses predicted at `theta`.

        These poses are followed under growing loads from poses interpolated between those of the
        data. `theta` is that of `predict`.
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

    If the model begins at measured poses, angles far from those of the trials made are left out.
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
        experiment=None if protocol.experiment is None else protocol.experiment[:1] * len(missing),
        experiments=protocol.experiments,
    )
    return concatenate([protocol, added], name=protocol.name)


# Standard deviations of a force by superposition and by pressure film [N], estimates: poses are
# replayed to some hundredths of a millimetre, and films err by a tenth of some hundred newtons.
TENSION_SD, CONTACT_SD = 5.0, 20.0
N_VALUES = 2


def current_state(protocol: Protocol) -> str:
    """The state with the most cuts, which is the last one, because cuts are final."""
    return max(reversed(protocol.states), key=lambda x: len(cuts_of(x)))


def with_state(protocol: Protocol, state: str) -> Protocol:
    """All trials of a protocol in one state."""
    return replace(protocol, state=(state,) * protocol.n)


def strongest_trials(protocol: Protocol, held: Sequence[float] = (0.0,) * len(LOADS)) -> Protocol:
    """Trials with the largest single load in each direction at each flexion angle.

    Loads `held` in all trials do not count.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> strongest_trials(load_protocol("seed63")).n
    12
    """
    dominant, flexion = dominant_loads(protocol), nominal_flexion(protocol)
    is_single = np.count_nonzero(protocol.loads - np.asarray(held), axis=1) == 1
    best: dict[tuple[float, int, float], int] = {}
    for i in np.flatnonzero(is_single).tolist():
        size = float(dominant.size[i])
        key = (float(flexion[i]), int(dominant.axis[i]), float(np.sign(size)))
        if key not in best or abs(size) > abs(float(dominant.size[best[key]])):
            best[key] = i
    return protocol.select(sorted(best.values()))


def structures_left(model: LaxityModel, state: str) -> tuple[str, ...]:
    """Ligaments and groups of the knee that are not cut through in a state."""
    gone = {x.ligament for x in cuts_of(state) if not x.is_partial}
    return tuple(x for x in model.tied.names if not gone & {x, *members_of(model.knee, x)})


@declared
class LaxityAfterCut:
    """Trials in the state after one more cut."""

    ligament: str = entry("The ligament or group that is cut")
    trials: tuple[str, ...] = entry("Names of the trials before the cut")
    laxity: CandidateLaxity = entry("The trials after it")


def trials_made_again(offered: CandidateLaxity) -> Protocol:
    """The strongest of the trials that were made, as offered at their nominal angles and loads.

    If none of those has a single load, the strongest of all trials offered.
    """
    made, trials = offered.laxity.protocol, offered.protocol
    flexion, dominant = np.round(nominal_flexion(made)), dominant_loads(made)
    kinds = {*zip(flexion, dominant.axis, np.sign(dominant.size), strict=True)}
    own = dominant_loads(trials)
    of = zip(np.round(trials.flexion_deg), own.axis, np.sign(own.size), strict=True)
    again = trials.select([i for i, kind in enumerate(of) if kind in kinds])
    held = nominal_held_loads(made)
    strongest = strongest_trials(again, held)
    return strongest if strongest.n else strongest_trials(trials, held)


def laxity_after_cuts(offered: CandidateLaxity, state: str) -> tuple[LaxityAfterCut, ...]:
    """The strongest trials made, repeated after each possible next cut."""
    trials = trials_made_again(offered)
    left = structures_left(offered.model, state)
    found = []
    for ligament in left if len(left) > 1 else ():
        names = tuple(f"{x} without {ligament}" for x in trials.trials)
        cut = with_state(replace(trials, trials=names), state_with(state, ligament))
        laxity = replace(offered, protocol=cut)
        found.append(LaxityAfterCut(ligament=ligament, trials=trials.trials, laxity=laxity))
    return tuple(found)


@declared
class CandidateForces:
    """Forces that may be measured in trials: the tension of a structure, or the contact forces.

    A trial has one candidate for each structure, then one for both compartments.
    """

    model: LaxityModel = entry("The model under the trials, from the poses at which they begin")
    free: FreeParameters = entry("The parameters that vary, and the values of the others")
    structures: tuple[str, ...] = entry("Ligaments and groups whose tension may be measured")
    has_contact: bool = entry("Whether contact forces may be measured")

    @property
    def places(self) -> list[tuple[int, str]]:
        """Trial and structure of each candidate; no name for the contact forces."""
        kinds = (*self.structures, *([""] if self.has_contact else []))
        return [(i, x) for i in range(self.model.protocol.n) for x in kinds]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates."""
        trials = self.model.protocol.trials
        return tuple(
            f"tension of {x} in {trials[i]}" if x else f"contact forces in {trials[i]}"
            for i, x in self.places
        )

    def predict(self, theta: Array, chosen: Sequence[int]) -> tuple[Array, Array]:
        """The forces in units of their errors and their derivatives, ``(k, 2)``, ``(k, 2, n)``.

        The second value of a tension is always 0. NaN in a trial without equilibrium.
        """
        found = self.model.predict(self.free.expand(theta))
        trials = range(self.model.protocol.n)
        loads = structure_loads(self.model, found)
        columns = [structure_names(self.model).index(x) for x in self.structures]
        m = len(columns)
        by_theta = self.free.restrict(loads.tension_jacobian)
        values = np.zeros((len(trials), m + self.has_contact, N_VALUES))
        jacobians = np.zeros((*values.shape, by_theta.shape[-1]))
        values[:, :m, 0] = loads.tensions[:, columns] / TENSION_SD
        jacobians[:, :m, 0] = by_theta[:, columns] / TENSION_SD
        if self.has_contact:
            slopes = contact_jacobian(self.model, found, trials)[:, :, 0]
            values[:, m] = contact_values(found)[:, :, 0] / CONTACT_SD
            jacobians[:, m] = self.free.restrict(slopes) / CONTACT_SD
        is_lost = ~found.is_converged
        values[is_lost], jacobians[is_lost] = np.nan, np.nan
        k = list(chosen)
        return values.reshape(-1, N_VALUES)[k], jacobians.reshape(-1, *jacobians.shape[2:])[k]

    def with_start_poses(self, theta: Array) -> "CandidateForces":
        """The same forces, with equilibria followed from the poses of the model at `theta`."""
        return replace(self, model=continued_from_own_poses(self.model, self.free.expand(theta)))


def candidate_forces(
    offered: CandidateLaxity, state: str, *, has_tensions: bool, has_contact: bool
) -> CandidateForces:
    """Forces of the remaining structures in the strongest trials made, repeated in `state`."""
    trials = with_state(trials_made_again(offered), state)
    return CandidateForces(
        model=offered.model.with_protocol(trials),
        free=offered.free,
        structures=structures_left(offered.model, state) if has_tensions else (),
        has_contact=has_contact,
    )
