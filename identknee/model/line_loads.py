"""Tensions and strains of lines, ligaments, groups and added structures, with derivatives."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.ligament_tensions import LigamentTensions, ligament_tensions
from identknee.model.laxity_model import LaxityModel
from identknee.model.mechanics_inputs import PER_PCT, MechanicsInputs
from identknee.model.parameter_groups import lines_by_units
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array, array, declared, entries, entry


@declared
class LineLoads:
    """Tensions and strains of the m lines in n trials, with derivatives by p parameters.

    NaN in trials that did not converge.
    """

    tensions: Array = array("Tensions", "trial", "line", unit="N")
    strains: Array = array("Strains, negative where a line is slack", "trial", "line", unit="%")
    tension_jacobian: Array = array(
        "Derivatives of the tensions", "trial", "line", "parameter", unit="N per unit of each"
    )
    strain_jacobian: Array = array(
        "Derivatives of the strains", "trial", "line", "parameter", unit="% per unit of each"
    )
    stiffness_jacobian: Array = array(
        "Derivatives of the stiffness of each line", "line", "parameter", unit="N per unit of each"
    )


def line_loads(model: LaxityModel, prediction: Prediction) -> LineLoads:
    """Tensions and strains of all lines in a prediction, effects included, with derivatives.

    A parameter changes them directly and by moving the tibia. Derivatives at a fixed pose are in
    closed form; those by amplitudes of effects and nuisances are differences of closed forms.

    Raises
    ------
    ValueError
        If the prediction was made without derivatives.
    """
    theta, nodes, u = prediction.theta, model.paths.trial_node, model.tied.n
    amplitudes, settings = model.amplitudes(theta), _settings(model, theta)
    setting = settings[-1]
    found = _of_lines(model, setting, prediction)
    m = setting.stiffness.size
    by_theta = lines_by_units(setting.owned(len(model.knee.ligaments)), setting.share, model.tied)
    moved = np.nan_to_num(prediction.pose_slopes)
    tensions, strains = found.by_pose @ moved, found.strains_by_pose @ moved
    tensions[:, :, : 2 * u] += found.by_stiffness[:, :, None] * by_theta[:m]
    tensions[:, :, : 2 * u] += found.by_strain[:, :, None] * by_theta[m:]
    strains[:, :, : 2 * u] += found.strains_by_strain[:, :, None] * by_theta[m:]
    stiffness = np.zeros((m, theta.size))
    stiffness[:, : 2 * u] = by_theta[:m]
    if amplitudes.size:
        slopes, stiffness[:, 2 * u :] = model.extension.line_changes(
            settings, amplitudes, prediction.poses, nodes, _tensions_and_strains
        )
        tensions[:, :, 2 * u :] += slopes[:, :, 0]
        strains[:, :, 2 * u :] += slopes[:, :, 1]
    is_lost = ~prediction.is_converged
    values = np.array(found.tensions), found.strains / PER_PCT, tensions, strains / PER_PCT
    for x in values:
        x[is_lost] = np.nan
    return LineLoads(
        tensions=values[0],
        strains=values[1],
        tension_jacobian=values[2],
        strain_jacobian=values[3],
        stiffness_jacobian=stiffness,
    )


def _tensions_and_strains(lines: LineLigaments, *at: Array) -> Array:
    """Tension and strain of each line, shape ``(n, m, 2)``."""
    found = ligament_tensions(lines, *at)
    return np.stack([found.tensions, found.strains], axis=2)


@declared
class Structures:
    """The structures that the lines of a model belong to, at one theta."""

    names: tuple[str, ...] = entry(
        "Names of all ligaments, then of the groups and of the structures that effects add"
    )
    member: Array = array("1 where a line is part of a structure, else 0", "line", "structure")
    weight: Array = array(
        "Share of each line in the stiffness of the structure, defined also where that is zero",
        *("line", "structure"),
    )
    stiffness: Array = array("Stiffness of each structure", "structure", unit="N")


def structure_names(model: LaxityModel) -> tuple[str, ...]:
    """Names of all structures with a tension: ligaments, groups and those that effects add."""
    return structures(model, model.parameters.start).names


def structures(model: LaxityModel, theta: Array) -> Structures:
    """The ligaments, groups and added structures of a model, and their lines.

    Springs of an effect, which push and pull, are no structures. In a model with several parts all
    have the same structures, and weights are those of the first.
    """
    if model.parts:
        first = model.parts[0]
        return structures(first.model, theta[first.columns])
    settings = _settings(model, theta)
    setting, tied = settings[-1], model.tied
    owned = setting.owned(len(model.knee.ligaments))
    shares = owned * setting.share[:, None]
    members = dict(zip((x.name for x in model.knee.ligaments), owned.T, strict=True))
    # Weights of the lines of a structure whose stiffness is zero: the limit of a small stiffness.
    counts = dict(zip(members, shares.T, strict=True))
    for name, member, share in zip(tied.names, tied.member.T, tied.by_stiffness.T, strict=True):
        members.setdefault(name, owned @ member)
        counts.setdefault(name, shares @ share)
    added = np.full(len(owned), "", object)
    added[setting.owner < 0] = model.extension.added_lines(settings)
    added[np.asarray(setting.lines.transition) < 0.0] = ""
    for name in dict.fromkeys(added[added != ""].tolist()):
        members.setdefault(name, (added == name).astype(float))
        counts.setdefault(name, members[name])
    member = np.column_stack([*members.values()])
    stiffness = setting.stiffness @ member
    part = np.where(
        stiffness > 0.0,
        setting.stiffness[:, None] * member,
        np.column_stack([*counts.values()]),
    )
    return Structures(
        names=tuple(members),
        member=member,
        weight=_normed(part),
        stiffness=stiffness,
    )


def _normed(part: Array) -> Array:
    """Columns scaled to the sum 1; NaN for a structure that is cut through, as it has no strain."""
    whole = part.sum(axis=0)
    return np.asarray(part / np.where(whole > 0.0, whole, np.nan))


def _settings(model: LaxityModel, theta: Array) -> list[MechanicsInputs]:
    """The inputs at theta, then with one more effect each time."""
    return model.extension.changes(model.setting(theta, is_changed=False), model.amplitudes(theta))


@declared
class StructureLoads:
    """Tensions and strains of ligaments, groups and added structures, with derivatives.

    The tension of a structure is the sum of those of its lines. Its strain is the mean of theirs,
    weighted by stiffness; it is negative where the structure is slack. NaN in trials that did not
    converge.
    """

    names: tuple[str, ...] = entry("Names of the structures")
    tensions: Array = array("Tensions", "trial", "structure", unit="N")
    strains: Array = array("Strains", "trial", "structure", unit="%")
    tension_jacobian: Array = array(
        "Derivatives of the tensions", "trial", "structure", "parameter", unit="N per unit of each"
    )
    strain_jacobian: Array = array(
        "Derivatives of the strains", "trial", "structure", "parameter", unit="% per unit of each"
    )


def structure_loads(model: LaxityModel, prediction: Prediction) -> StructureLoads:
    """Tensions and strains of all structures in a prediction, with exact derivatives.

    Raises
    ------
    ValueError
        As `line_loads`.
    """
    if model.parts:
        return _structure_loads_of_parts(model, prediction)
    lines, owners = line_loads(model, prediction), structures(model, prediction.theta)
    strains = lines.strains @ owners.weight
    # The weights of the mean strain change where an amplitude changes the stiffness of one line.
    relative = np.divide(
        owners.member,
        owners.stiffness,
        out=np.zeros(owners.member.shape),
        where=owners.stiffness > 0,
    )
    apart = (lines.strains[:, :, None] - strains[:, None]) * relative
    return StructureLoads(
        names=owners.names,
        tensions=lines.tensions @ owners.member,
        strains=strains,
        tension_jacobian=owners.member.T @ lines.tension_jacobian,
        strain_jacobian=owners.weight.T @ lines.strain_jacobian
        + np.swapaxes(apart, 1, 2) @ lines.stiffness_jacobian,
    )


def added_line_tensions(
    model: LaxityModel,
    prediction: Prediction,
    ends: tuple[Array, Array],
    stiffness: Array,
    reference_strain: Array,
) -> LigamentTensions:
    """Tensions of lines that the model does not have, at the poses of a prediction.

    Parameters
    ----------
    model, prediction
        The model and its prediction.
    ends
        Femoral and tibial ends in the axes of their bones [mm], shape ``(k, 3)`` each; lengths are
        measured in the scanned pose.
    stiffness, reference_strain
        Stiffness [N] and reference strain [-] of each line, shape ``(k,)``.
    """
    if model.parts:
        found = [
            added_line_tensions(
                x.model, x.prediction(prediction), ends, stiffness, reference_strain
            )
            for x in model.parts
        ]
        # Back to the order of the trials of the whole model.
        order = np.argsort(np.concatenate([x.trials for x in model.parts]))
        return LigamentTensions(
            **{
                x: np.concatenate([getattr(one, x) for one in found])[order]
                for x in entries(LigamentTensions)
            }
        )
    setting = model.setting(prediction.theta)
    lines = LineLigaments(femoral=ends[0], tibial=ends[1], reference_length=np.ones(len(ends[0])))
    lines = replace(lines, reference_length=setting.lengths_at_start(lines))
    flexion = setting.flexion[model.paths.trial_node]
    return ligament_tensions(
        setting.as_measured(lines), flexion, prediction.poses, stiffness, reference_strain
    )


def _structure_loads_of_parts(model: LaxityModel, prediction: Prediction) -> StructureLoads:
    found = [structure_loads(x.model, x.prediction(prediction)) for x in model.parts]
    n, k, p = len(prediction.codes), len(found[0].names), prediction.theta.size
    values = {x: np.zeros((n, k)) for x in ("tensions", "strains")}
    slopes = {f"{x}_jacobian": np.zeros((n, k, p)) for x in ("tension", "strain")}
    for part, loads in zip(model.parts, found, strict=True):
        for name, whole in values.items():
            whole[part.trials] = getattr(loads, name)
        for name, into in slopes.items():
            part.spread(getattr(loads, name), into)
    return StructureLoads(names=found[0].names, **values, **slopes)


def tensions_of(model: LaxityModel, prediction: Prediction) -> Array:
    """Tension of every ligament in every trial [N], shape ``(n, n_ligaments)``.

    If an effect splits a ligament into bundles, it is the sum over these. NaN in trials that did
    not converge.
    """
    return _of_trials(_of_ligaments, model, prediction)[0]


def strains_of(model: LaxityModel, prediction: Prediction) -> Array:
    """Strain of every ligament in every trial [%], shape ``(n, n_ligaments)``.

    If an effect splits a ligament into bundles, it is their mean weighted by stiffness. Negative
    where the ligament is slack; NaN where it is cut through and in trials that did not converge.
    """
    return _of_trials(_of_ligaments, model, prediction)[1]


def structure_values(model: LaxityModel, prediction: Prediction, name: str) -> tuple[Array, Array]:
    """Tension [N] and strain [%] of one structure in every trial, shape ``(n,)`` each.

    As `values_of_structures`.
    """
    tensions, strains = values_of_structures(model, prediction, [name])
    return tensions[:, 0], strains[:, 0]


def values_of_structures(
    model: LaxityModel, prediction: Prediction, names: Sequence[str]
) -> tuple[Array, Array]:
    """Tension [N] and strain [%] of k structures in every trial, shape ``(n, k)`` each.

    Raises
    ------
    ValueError
        If the model has no structure of a name.
    """
    return _of_trials(partial(_of_structures, names), model, prediction)


def _of_trials(
    computed: Callable[[LaxityModel, Prediction], tuple[Array, Array]],
    model: LaxityModel,
    prediction: Prediction,
) -> tuple[Array, Array]:
    """Two arrays with a row for each trial, computed by parts where the model has some."""
    if model.parts:
        found = [_of_trials(computed, x.model, x.prediction(prediction)) for x in model.parts]
        order = np.argsort(np.concatenate([x.trials for x in model.parts]))
        first, second = (np.concatenate(x)[order] for x in zip(*found, strict=True))
        return first, second
    first, second = computed(model, prediction)
    for values in (first, second):
        values[~prediction.is_converged] = np.nan
    return first, second


def _of_structures(
    names: Sequence[str], model: LaxityModel, prediction: Prediction
) -> tuple[Array, Array]:
    owners = structures(model, prediction.theta)
    found = _of_lines(model, model.setting(prediction.theta), prediction)
    chosen = [index_of(x, owners.names, "ligament") for x in names]
    # One product for each, so that a result does not depend on the others by rounding.
    tensions = np.column_stack([found.tensions @ owners.member[:, k] for k in chosen])
    strains = np.column_stack([found.strains @ owners.weight[:, k] for k in chosen])
    return tensions, strains / PER_PCT


def _of_ligaments(model: LaxityModel, prediction: Prediction) -> tuple[Array, Array]:
    setting, m = model.setting(prediction.theta), len(model.knee.ligaments)
    found, owned = _of_lines(model, setting, prediction), setting.owned(m)
    weight = _normed(owned * setting.share[:, None])
    return found.tensions @ owned, found.strains @ weight / PER_PCT


def _of_lines(
    model: LaxityModel, setting: MechanicsInputs, prediction: Prediction
) -> LigamentTensions:
    return ligament_tensions(
        setting.measured_lines,
        setting.flexion[model.paths.trial_node],
        prediction.poses,
        setting.stiffness,
        setting.reference_strain,
    )


def index_of(name: str, names: Sequence[str], kind: str) -> int:
    """Index of a name in `names`; `kind` is the word for it in the error.

    Raises
    ------
    ValueError
        If the name is not in `names`.
    """
    if name not in names:
        shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        raise ValueError(f"there is no {kind} {name!r}; there are {shown}")
    return list(names).index(name)
