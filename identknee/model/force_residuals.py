"""Residuals of measured forces: of trials, and in-situ forces of replayed paths.

They are in units of their errors. The in-situ wrench of a structure is predicted in the model's
equilibrium of the trial whose path was replayed. An error of the replayed pose changes it by the
stiffness of the structure: it adds ``K S K'`` to the covariance of the readings. The stiffness K is
computed at one parameter vector and kept, so that the size of the errors does not change during a
fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from identknee.laxity.experiments import cuts_of
from identknee.laxity.forces import WRENCH, MeasuredForces, Superposition
from identknee.laxity.table import Laxity
from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.ligament_tensions import line_wrenches, twists_by_pose
from identknee.model.contact_loads import contact_jacobian, contact_values
from identknee.model.effects.effect import OF
from identknee.model.experiments import gone_in, members_of
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import (
    index_of,
    structure_loads,
    structure_names,
    structures,
    values_of_structures,
)
from identknee.model.nuisances import CELL
from identknee.model.parameter_groups import lines_by_units
from identknee.model.parameters import Parameters
from identknee.model.prediction import Prediction
from identknee.model.quantities import CONTACT, quantity_place
from identknee.runs.declare import Array, IntArray, array, declared, short_repr
from identknee.runs.errors import ValueRefused


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceResiduals:
    """Predicted less measured forces, in standard deviations of their errors.

    Attributes
    ----------
    model
        The model under the protocol of the data.
    forces
        The measured forces.
    is_everywhere
        Whether forces of trials without equilibrium are left out, as in a search that begins
        anywhere; otherwise their residuals are infinite.

    Raises
    ------
    ValueError
        If the model lacks a structure whose force was measured, or it is cut in that trial.
    """

    model: LaxityModel
    forces: MeasuredForces
    is_everywhere: bool = False
    _places: tuple[tuple[str, int], ...] = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Check that the model has what was measured."""
        protocol, forces, knee = self.model.protocol, self.forces, self.model.knee
        for trial, k in np.argwhere(forces.is_measured).tolist():
            owner = forces.names[k].rpartition(".")[0]
            if members_of(knee, owner) <= gone_in(knee, protocol.states[trial]):
                raise ValueRefused(
                    f"the table has the force of {owner} in {protocol.trials[trial]}, where it is "
                    "cut",
                    "leave that cell blank",
                )
        places = tuple(quantity_place(self.model, x) for x in forces.names)
        object.__setattr__(self, "_places", places)

    @property
    def parameters(self) -> Parameters:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def n(self) -> int:
        """Number of measured forces."""
        return int(self.forces.is_measured.sum())

    @property
    def trials(self) -> IntArray:
        """Index of the trial of each force, shape ``(n,)``."""
        return np.nonzero(self.forces.is_measured)[0]

    def predicted(self, theta: Array) -> Array:
        """The forces of all trials, shape ``(trials, forces)``; NaN without an equilibrium."""
        prediction = self.model.predict_once(theta)
        is_contact = np.array([kind == CONTACT for kind, _ in self._places])
        of_contact = [i for kind, i in self._places if kind == CONTACT]
        values = np.empty(self.forces.values.shape)
        values[:, is_contact] = contact_values(prediction)[:, of_contact, 0]
        if not is_contact.all():
            names = [x.rpartition(".")[0] for x in np.array(self.forces.names)[~is_contact]]
            values[:, ~is_contact] = values_of_structures(self.model, prediction, names)[0]
        return values

    def residuals(self, theta: Array) -> Array:
        """Residuals, shape ``(n,)``."""
        measured = self.forces.is_measured
        left = (self.predicted(theta) - self.forces.values)[measured] / self._sd
        return np.where(np.isnan(left), 0.0 if self.is_everywhere else np.inf, left)

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives by theta, shape ``(n, p)``."""
        prediction, measured = self.model.predict_once(theta), self.forces.is_measured
        slopes = np.zeros((*measured.shape, self.parameters.n))
        kinds = [kind for kind, _ in self._places]
        if CONTACT in kinds:
            of_contact = measured[:, [x == CONTACT for x in kinds]].any(axis=1)
            trials = np.flatnonzero(of_contact).tolist()
            contact = contact_jacobian(self.model, prediction, trials)
        if set(kinds) != {CONTACT}:
            tensions = structure_loads(self.model, prediction).tension_jacobian
        for k, (kind, i) in enumerate(self._places):
            if kind == CONTACT:
                slopes[trials, k] = contact[:, i, 0]
            else:
                slopes[:, k] = tensions[:, i]
        rows = slopes[measured] / self._sd[:, None]
        return np.nan_to_num(rows) if self.is_everywhere else rows

    @property
    def _sd(self) -> Array:
        return np.asarray(self.forces.sd[self.forces.is_measured])


@declared
class StructureWrenches:
    """Wrenches of structures on the tibia; each row is one structure in one trial.

    Forces and moments about the tibial origin, in tibial axes. NaN where a trial has no
    equilibrium.
    """

    values: Array = array("Force and moment", "row", "wrench_component", unit="N and N m")
    jacobian: Array = array("Derivatives by the parameters", "row", "wrench_component", "parameter")
    by_twist: Array = array(
        "Derivatives by a motion of the tibia along and about its axes [mm, rad]",
        *("row", "wrench_component", "6"),
    )


def structure_wrenches(
    model: LaxityModel, prediction: Prediction, trials: Sequence[int], names: Sequence[str]
) -> StructureWrenches:
    """Wrenches of structures in the predicted poses, with exact derivatives.

    Parameters
    ----------
    model, prediction
        The model, and its prediction with derivatives.
    trials, names
        Index of the trial and name of the structure, of each row.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives, or the model has no such structure.
    """
    if not model.parts:
        return _of_one_part(model, prediction, np.asarray(trials, np.int64), names)
    n, k = len(trials), len(WRENCH)
    values, by_twist = np.full((n, k), np.nan), np.full((n, k, k), np.nan)
    jacobian = np.full((n, k, prediction.theta.size), np.nan)
    for part in model.parts:
        rows, own = part.places(trials)
        if rows.size:
            cut = [names[i] for i in rows]
            found = _of_one_part(part.model, part.prediction(prediction), own, cut)
            values[rows], by_twist[rows] = found.values, found.by_twist
            part.spread(found.jacobian, jacobian, rows)
    return StructureWrenches(values=values, jacobian=jacobian, by_twist=by_twist)


def _of_one_part(
    model: LaxityModel, prediction: Prediction, trials: IntArray, names: Sequence[str]
) -> StructureWrenches:
    theta, u = prediction.theta, model.tied.n
    owners = structures(model, theta)
    member = owners.member[:, [index_of(x, owners.names, "ligament") for x in names]].T
    used, row = np.unique(trials, return_inverse=True)
    nodes, poses = model.paths.trial_node[used], prediction.poses[used]
    amplitudes = model.amplitudes(theta)
    settings = model.extension.changes(model.setting(theta, is_changed=False), amplitudes)
    setting = settings[-1]
    at = setting.flexion[nodes], poses, setting.stiffness, setting.reference_strain
    found = line_wrenches(setting.measured_lines, *at)
    m = setting.stiffness.size
    by_line = lines_by_units(setting.owned(len(model.knee.ligaments)), setting.share, model.tied)
    by_twist = _summed(member, found.by_twist[row])
    moved = twists_by_pose(poses) @ np.nan_to_num(prediction.pose_slopes[used])
    jacobian = by_twist @ moved[row]
    for slopes, units in ((found.by_stiffness, by_line[:m]), (found.by_strain, by_line[m:])):
        own = slopes[row] * member[:, :, None]
        jacobian[:, :, : 2 * u] += np.swapaxes(own, 1, 2) @ units
    if amplitudes.size:
        changes, _ = model.extension.line_changes(settings, amplitudes, poses, nodes, _wrenches)
        jacobian[:, :, 2 * u :] += _summed(member, changes[row])
    values = _summed(member, found.values[row])
    is_lost = ~prediction.is_converged[trials]
    for x in (values, jacobian, by_twist):
        x[is_lost] = np.nan
    return StructureWrenches(values=values, jacobian=jacobian, by_twist=by_twist)


def _summed(member: Array, of_lines: Array) -> Array:
    """Sums over the lines of each row's structure, shape ``(r, ...)`` of ``(r, m, ...)``."""
    return np.asarray(np.einsum("rm,rm...->r...", member, of_lines))


def _wrenches(lines: LineLigaments, *at: Array) -> Array:
    """The wrench of each line, shape ``(n, m, 6)``."""
    return np.array(line_wrenches(lines, *at).values)


FORCE, N_COMPONENTS = slice(0, 3), len(WRENCH)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SuperpositionResiduals:
    """Predicted less measured in-situ forces, whitened by the covariance of their errors.

    Attributes
    ----------
    model
        The model under the protocol of the data.
    superposition
        The measured in-situ forces. If they have no covariance yet, that at the model's start is
        used.
    offset
        Added to the predicted readings of the cell, shape ``(rows, 6)``; None adds nothing.
    is_everywhere
        Whether forces of trials without equilibrium are left out, as in a search that begins
        anywhere; otherwise all residuals are infinite then.

    Raises
    ------
    ValueError
        If the model lacks a structure that was cut, if it had been cut before, or if a part of it
        had been and the path was measured without that part.
    """

    model: LaxityModel
    superposition: Superposition
    offset: Array | None = None
    is_everywhere: bool = False
    _trials: tuple[int, ...] = field(init=False, repr=False)
    _offsets: Array = field(init=False, repr=False)
    _whitening: Array = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Check that the model has what was cut."""
        model, made = self.model, self.superposition
        trials = tuple(model.protocol.trials.index(x) for x in made.trials)
        for row, trial in enumerate(trials):
            index_of(made.cut[row], structure_names(model), "ligament")
            _check_cut(model, made, row, trial)
        object.__setattr__(self, "_trials", trials)
        object.__setattr__(self, "_offsets", _offset_slopes(model, trials))
        covariance = made.covariance
        if covariance is None:
            covariance = error_covariance(model, made, model.parameters.start)
        object.__setattr__(self, "_whitening", np.linalg.inv(np.linalg.cholesky(covariance)))

    @property
    def parameters(self) -> Parameters:
        """The parameters of the model."""
        return self.model.parameters

    @property
    def n(self) -> int:
        """Number of measured values."""
        return self.superposition.n_values

    @property
    def trials(self) -> IntArray:
        """Index of the trial of each value, shape ``(n,)``."""
        return np.array(self._trials)[np.nonzero(self.superposition.is_measured)[0]]

    def predicted(self, theta: Array) -> Array:
        """Predicted readings of the cell, and the size of the force, shape ``(rows, 7)``."""
        wrenches = self._readings(theta)
        size = np.linalg.norm(wrenches[:, FORCE], axis=1, keepdims=True)
        return np.concatenate([wrenches, size], axis=1)

    @property
    def sd(self) -> Array:
        """Standard deviation of each value, errors of the pose included, shape ``(rows, 7)``."""
        spread = np.full(self.superposition.values.shape, np.nan)
        spread[self.superposition.is_measured] = np.linalg.norm(
            np.linalg.inv(self._whitening), axis=1
        )
        return spread

    def residuals(self, theta: Array) -> Array:
        """Residuals, shape ``(n,)``; infinite where a trial has no equilibrium."""
        made = self.superposition
        left = (self.predicted(theta) - made.values)[made.is_measured]
        lost = np.isnan(left)
        if lost.any() and not self.is_everywhere:
            return np.full(self.n, np.inf)
        return np.asarray(self._whitening @ np.where(lost, 0.0, left))

    def jacobian(self, theta: Array) -> Array:
        """Their derivatives by theta, shape ``(n, p)``."""
        slopes = self._found(theta).jacobian + self._offsets
        direction = _directions(self._readings(theta))
        by_size = np.einsum("ri,rip->rp", direction, slopes[:, FORCE])
        rows = np.concatenate([slopes, by_size[:, None]], axis=1)[self.superposition.is_measured]
        return np.asarray(self._whitening @ (np.nan_to_num(rows) if self.is_everywhere else rows))

    def offset_at(self, theta: Array) -> Array:
        """What constant errors of the cells add to each row, shape ``(rows, 6)``."""
        added = self._offsets @ theta
        return np.asarray(added if self.offset is None else added + self.offset)

    def _readings(self, theta: Array) -> Array:
        return np.asarray(self._found(theta).values + self.offset_at(theta))

    def _found(self, theta: Array) -> StructureWrenches:
        prediction = self.model.predict_once(theta)
        return _cut_wrenches(self.model, prediction, self.superposition)


def _check_cut(model: LaxityModel, made: Superposition, row: int, trial: int) -> None:
    """Refuse a structure that was gone, or that was cut in part after its path was made."""
    knee, state = model.knee, model.protocol.states[trial]
    members = members_of(knee, made.cut[row])
    if members <= gone_in(knee, state):
        raise ValueRefused(
            f"{made.words(row)}: it was cut before this path was made",
            "name the trial whose path was replayed",
        )
    if members <= gone_in(knee, made.before[row]):
        raise ValueRefused(
            f"{made.words(row)}: nothing of it was left in the state {made.before[row]!r} before",
            "give the states of the knee before and after the cut",
        )
    known = {x.words for x in cuts_of(state)}
    later = [x for x in cuts_of(made.before[row]) if x.is_partial and x.words not in known]
    if any(members & members_of(knee, x.ligament) for x in later):
        raise ValueRefused(
            f"{made.words(row)}: a part of it was cut after this path was made",
            "replay a path that was made in the state before",
        )


# Residuals and their Jacobian are asked for one after the other.
@lru_cache(maxsize=2)
def _cut_wrenches(
    model: LaxityModel, prediction: Prediction, made: Superposition
) -> StructureWrenches:
    """The wrench of what each cut took away, of a group the bundles that were left before."""
    rows, names = [], []
    for row, (cut, before) in enumerate(zip(made.cut, made.before, strict=True)):
        members, gone = members_of(model.knee, cut), gone_in(model.knee, before)
        left = sorted(members - gone) if members & gone else [cut]
        rows += [row] * len(left)
        names += left
    places = {name: i for i, name in enumerate(model.protocol.trials)}
    trials = [places[made.trials[row]] for row in rows]
    found = structure_wrenches(model, prediction, trials, names)
    if len(rows) == made.n:
        return found
    parts = (found.values, found.jacobian, found.by_twist)
    values, jacobian, by_twist = (_by_row(x, rows, made.n) for x in parts)
    return StructureWrenches(values=values, jacobian=jacobian, by_twist=by_twist)


def _by_row(parts: Array, rows: Sequence[int], n: int) -> Array:
    """Sums of parts (k, ...) by the row of each, shape ``(n, ...)``; NaN where one is."""
    whole = np.zeros((n, *parts.shape[1:]))
    np.add.at(whole, np.array(rows), parts)
    return whole


def _offset_slopes(model: LaxityModel, trials: tuple[int, ...]) -> Array:
    """Derivatives of what the cell reads by the constant errors of each rig's, ``(r, 6, p)``."""
    protocol, names = model.protocol, model.parameters.names
    slopes = np.zeros((len(trials), N_COMPONENTS, len(names)))
    rigs = {x.name: x.rig for x in protocol.experiments}
    only = next(iter(rigs.values()), "")
    for row, trial in enumerate(trials):
        rig = only if protocol.experiment is None else rigs[protocol.experiment[trial]]
        for i, component in enumerate(WRENCH):
            if (name := f"{rig}{OF}{CELL}.{component}") in names:
                slopes[row, i, names.index(name)] = 1.0
    return slopes


def _directions(wrenches: Array) -> Array:
    """Unit vectors along forces, zero where there is none, shape ``(r, 3)``."""
    forces = wrenches[:, FORCE]
    size = np.linalg.norm(forces, axis=1, keepdims=True)
    return np.asarray(np.divide(forces, size, out=np.zeros(forces.shape), where=size > 0.0))


def weighed(laxity: Laxity, model: LaxityModel, theta: Array) -> Laxity:
    """The data with the covariance of their in-situ forces, stiffnesses taken at `theta`."""
    if (made := laxity.superposition) is None:
        return laxity
    covariance = error_covariance(model, made, theta)
    return replace(laxity, superposition=replace(made, covariance=covariance))


def error_covariance(model: LaxityModel, made: Superposition, theta: Array) -> Array:
    """Covariance of the errors of all measured values, shape ``(n, n)``.

    Parameters
    ----------
    model
        The model under the protocol of the data.
    made
        What was measured.
    theta
        Where the stiffness of structures is taken, and the direction of forces of which only the
        size was measured. Where a trial has no equilibrium there, errors of its pose count as
        nothing.
    """
    shares, replayed = made.shares(), made.pose_sd.any(axis=1)
    # What each value is of the three components of a force and of all six of a wrench.
    axes = np.zeros((made.n, N_COMPONENTS + 1, N_COMPONENTS))
    axes[:, :N_COMPONENTS] = np.eye(N_COMPONENTS)
    moved = np.zeros((made.n, N_COMPONENTS, 6))
    has_sizes = made.is_measured[:, N_COMPONENTS].any()
    if replayed.any() or has_sizes:
        found = _cut_wrenches(model, model.predict(theta), made)
        axes[:, N_COMPONENTS, FORCE] = _directions(np.nan_to_num(found.values))
        errors = np.repeat([made.pose_sd[:, 0], np.radians(made.pose_sd[:, 1])], 3, axis=0).T
        moved = np.nan_to_num(found.by_twist) * errors[:, None]
    seen = made.is_measured
    row = np.nonzero(seen)[0]
    along, sd = axes[seen], made.sd[seen]
    # A size has an error of its own also where the force, and so its direction, is unknown.
    common = along @ along.T
    np.fill_diagonal(common, 1.0)
    noise = sd[:, None] * shares[np.ix_(row, row)] * common * sd
    pushed = np.einsum("ki,kij->kj", along, moved[row])
    # Rows that replay a path from one state have one error of the pose.
    runs = list(zip(made.trials, made.before, strict=True))
    run = np.array([runs.index(runs[i]) for i in row])
    return np.asarray(noise + np.where(run[:, None] == run, pushed @ pushed.T, 0.0))
