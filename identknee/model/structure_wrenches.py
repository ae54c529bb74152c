"""Wrenches of ligaments, groups and added structures on the tibia, with derivatives."""

from collections.abc import Sequence

import numpy as np

from identknee.laxity.superposition import WRENCH
from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.line_wrenches import line_wrenches, twists_by_pose
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import index_of, structures
from identknee.model.parameter_groups import lines_by_units
from identknee.model.prediction import Prediction
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared


@declared
class StructureWrenches:
    """What structures do to the tibia in trials, one of each a row.

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
        Place of the trial, and name of the structure, of each row.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives, or the model has no such structure.
    """
    if prediction.pose_jacobian is None:
        raise ValueError("wrenches have derivatives only where the prediction has them")
    if not model.parts:
        return _of_one_part(model, prediction, np.asarray(trials, np.int64), names)
    n, k = len(trials), len(WRENCH)
    values, by_twist = np.full((n, k), np.nan), np.full((n, k, k), np.nan)
    jacobian = np.full((n, k, prediction.theta.size), np.nan)
    for part in model.parts:
        place = {int(x): i for i, x in enumerate(part.trials)}
        rows = [i for i, x in enumerate(trials) if x in place]
        if not rows:
            continue
        own = np.array([place[trials[i]] for i in rows])
        found = _of_one_part(part.model, part.prediction(prediction), own, [names[i] for i in rows])
        values[rows], by_twist[rows] = found.values, found.by_twist
        part.spread(found.jacobian, jacobian, np.array(rows))
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
    by_theta = np.zeros(0) if prediction.pose_jacobian is None else prediction.pose_jacobian[used]
    moved = twists_by_pose(poses) @ np.nan_to_num(by_theta)
    jacobian = by_twist @ moved[row]
    for slopes, units in ((found.by_stiffness, by_line[:m]), (found.by_strain, by_line[m:])):
        own = slopes[row] * member[:, :, None]
        jacobian[:, :, : 2 * u] += np.swapaxes(own, 1, 2) @ units
    if amplitudes.size:
        changes = model.extension.line_changes(settings, amplitudes, poses, nodes, _wrenches)
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
