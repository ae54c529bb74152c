"""What is missing where measured trials have no equilibrium, and which structures would hold them.

Such trials are not fitted, because a ligament would then be changed until it imitates a capsule. At
their measured poses they still show what the model lacks.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy

from identknee.laxity.protocol import ABSOLUTE
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity, LaxityError
from identknee.model.effects.facts import cause_label
from identknee.model.effects.library import library
from identknee.model.effects.structures import MissingStructure, PosteriorCapsule, Structure
from identknee.model.laxity_model import LaxityModel
from identknee.model.missing_wrench import (
    SCALE,
    MissingWrench,
    along_plateau,
    wrench_at_measured_poses,
)
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array, BoolArray, IntArray, declared, entry
from identknee.runs.findings import Finding, finding
from identknee.runs.words import amount, listed, listed_first
from identknee.subject.knee import Knee

SLACK_STRAINS = (-4.0, 0.0, 4.0, 8.0)  # %
# Error added to each missing force [N], moments over a lever of 20 mm: no structure is to be named
# for less, however exact the poses are.
SMALLEST = 1.0
# Least share of the missing forces for which a structure is named.
LEAST_SHARE = 0.5
FINEST = 0.01  # resolution of the best rig [mm, deg]
NO_ERROR = 1e-9  # share of the largest variance that is rounding
MOST_NAMED = 3
# Standard deviations from which on a component of the missing forces is reported.
CLEAR = 2.0


@declared
class Restraint:
    """A structure that would supply the missing forces in trials without equilibrium."""

    name: str = entry("Name of the structure in the library of causes")
    share: float = entry("Share of the missing forces that it supplies", unit="1")
    stiffness_kN: float = entry("Stiffness that supplies most", unit="kN")  # noqa: N815
    strain_pct: float = entry("Its reference strain", unit="%")
    n_held: int = entry("Trials that have an equilibrium with it", unit="1")


def missing_restraint_findings(
    model: LaxityModel, laxity: Laxity, prediction: Prediction, error: LaxityError
) -> tuple[Finding, ...]:
    """A finding on the forces missing in trials without equilibrium; none if all have one.

    Only trials with all five coordinates count, and only absolute coordinates.

    Parameters
    ----------
    model, laxity
        The model of the fit, and all measured trials.
    prediction
        Prediction of these trials at the fit.
    error
        Error of the fit, which stands for the noise where none is stated.
    """
    is_lost = laxity.is_measured.all(axis=1) & ~prediction.is_converged
    if not is_lost.any() or laxity.zero != ABSOLUTE or prediction.hessians is None:
        return ()
    sd = np.empty((laxity.n, 5))
    sd[:, TRANSLATIONS], sd[:, ROTATIONS] = max(FINEST, error.mm), max(FINEST, error.deg)
    if laxity.sd is not None:
        sd = np.where(np.isnan(laxity.sd), sd, laxity.sd)
    missing = wrench_at_measured_poses(
        model, laxity, prediction.theta, sd, laxity.within_trial_correlation
    )
    found = sorted(restraints(model, prediction.theta, missing, is_lost), key=lambda x: -x.share)
    return (_finding(laxity, missing, is_lost, found),)


def restraints(
    model: LaxityModel, theta: Array, missing: MissingWrench, is_lost: BoolArray
) -> Iterator[Restraint]:
    """Each structure of the library, at the stiffness and strain that supply most of `missing`.

    The missing forces outside the directions of contact are fitted by the pull of the structure in
    the same poses, by least squares in units of their errors. A structure pulls and never pushes.
    """
    lost = np.flatnonzero(is_lost)
    unit = _unit(missing, lost)
    wanted = np.einsum("nij,nj->ni", unit, missing.outside[lost]).ravel()
    for effect in _structures(model.knee):
        n = effect.first_shift - 1
        best, at = np.inf, np.zeros(n + 1)
        for strain in SLACK_STRAINS:
            pulls = structure_pulls(model, theta, missing.poses, effect, strain)[lost]
            rows = -(unit @ pulls).reshape(-1, n)
            solved = scipy.optimize.lsq_linear(rows, wanted, (0.0, effect.parameters.upper[:n]))
            if 2.0 * solved.cost < best:
                best, at = 2.0 * solved.cost, np.r_[solved.x, strain]
        values = np.zeros(effect.parameters.n)
        values[: n + 1] = at
        held = replace(model, effects=(*model.effects, effect)).predict(
            np.r_[theta, values], derivatives=False
        )
        yield Restraint(
            name=effect.name,
            share=1.0 - best / float(wanted @ wanted),
            stiffness_kN=float(at[:n].max()),
            strain_pct=float(at[n]),
            n_held=int(held.is_converged[lost].sum()),
        )


def _structures(knee: Knee) -> list[Structure]:
    """The structures of the library; none if they cannot be placed on the surfaces."""
    try:
        found = library(knee)
    except ValueError:
        return []
    return [x for x in found if isinstance(x, MissingStructure | PosteriorCapsule)]


def _unit(missing: MissingWrench, trials: IntArray) -> Array:
    """Matrices from missing forces outside contact to units of their errors, ``(n, 5, 5)``."""
    covariance = missing.outside_covariance[trials] / SCALE[:, None] / SCALE
    size, along = np.linalg.eigh(covariance)
    # Directions in which contact presses were removed and have no variance.
    is_outside = size > NO_ERROR * size[:, -1:]
    root = np.where(is_outside, 1.0 / np.sqrt(np.maximum(size, 0.0) + SMALLEST**2), 0.0)
    return np.asarray(root[:, :, None] * along.transpose(0, 2, 1) / SCALE)


def structure_pulls(
    model: LaxityModel,
    theta: Array,
    poses: Array,
    effect: Structure,
    strain: float,
) -> Array:
    """Gradient of the energy of a structure by its stiffnesses in given poses, ``(n, 5, k)``.

    Parameters
    ----------
    model, theta
        The model without it, and its parameters.
    poses
        Poses of the model's trials: varus, internal [rad], x, y, z [mm], shape ``(n, 5)``.
    effect
        The structure.
    strain
        Its reference strain [%].
    """
    n = effect.first_shift - 1
    if model.parts:
        whole = np.empty((len(poses), 5, n))
        for x in model.parts:
            own = theta[x.columns]
            whole[x.trials] = structure_pulls(x.model, own, poses[x.trials], effect, strain)
        return whole
    setting = model.setting(theta)
    values = np.zeros(effect.parameters.n)
    values[n] = strain
    flexion = setting.flexion[model.paths.trial_node]
    return effect.gradient_columns(setting, values, flexion, poses)[:, :, :n]


def _finding(
    laxity: Laxity, missing: MissingWrench, is_lost: BoolArray, found: list[Restraint]
) -> Finding:
    lost = np.flatnonzero(is_lost)
    trials = [laxity.protocol.trials[i] for i in lost]
    clearest = np.einsum("nij,nj->ni", _unit(missing, lost), missing.outside[lost])
    place = int(lost[np.argmax(np.linalg.norm(clearest, axis=1))])
    turn = along_plateau(missing.poses[place])
    loads = turn @ missing.outside[place]
    sd = np.sqrt(np.diag(turn @ missing.outside_covariance[place] @ turn.T))
    good = [x for x in found if x.share >= LEAST_SHARE][:MOST_NAMED]
    held_by = [
        f"{cause_label(x.name)} of {amount(x.stiffness_kN, 'kN', 2)} supplies "
        f"{100.0 * x.share:.0f} % and holds {x.n_held}"
        for x in good
    ]
    said = (
        f"Without equilibrium, {listed_first(trials, 1)} lack forces at their measured poses: "
        f"{_load_words(loads, sd)} in {laxity.protocol.trials[place]}. "
        + (
            f"Structures that would hold some of the {len(trials)}: {'; '.join(held_by)}."
            if good
            else "No single structure of the library supplies half of it."
        )
    )
    values = {
        "trials": trials,
        "clearest": laxity.protocol.trials[place],
        "anterior_force_N": loads[0],
        "lateral_force_N": loads[1],
        "internal_moment_Nm": 0.001 * loads[2],
        "sd_anterior_force_N": sd[0],
        "sd_lateral_force_N": sd[1],
        "sd_internal_moment_Nm": 0.001 * sd[2],
        "structures": [x.name for x in good],
        "shares": [x.share for x in good],
        "stiffnesses_kN": [x.stiffness_kN for x in good],
        "n_held": [x.n_held for x in good],
    }
    return finding("missing-restraint", "trials", values, sentence=said)


def _load_words(loads: Array, sd: Array) -> str:
    """The components that are larger than their errors, or the clearest one if none is."""
    kinds = (
        (1.0, ("anterior", "posterior"), "N"),
        (1.0, ("lateral", "medial"), "N"),
        (0.001, ("internal", "external"), "N·m"),
    )
    ratio = np.abs(loads) / sd
    clear = np.flatnonzero(ratio > min(CLEAR, float(ratio.max()) * (1.0 - 1e-9)))
    words = []
    for i in clear.tolist():
        factor, (positive, negative), unit = kinds[i]
        direction = positive if loads[i] > 0.0 else negative
        value, error = amount(abs(factor * loads[i]), unit, 2), amount(factor * sd[i], "", 1)
        words.append(f"{value} {direction} (sd {error})")
    return listed(words)
