"""Slack lengths of 18 ligaments from laxity and ACL forces, on simulated knees."""

from dataclasses import dataclass, replace

import numpy as np
from common.records import BUNDLES, Row, rounded, study_knee

import identknee as ik
from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.problem import evaluate
from identknee.laxity.forces import MeasuredForces
from identknee.laxity.protocol import Protocol, concatenate
from identknee.model.line_loads import (
    StructureLoads,
    structure_loads,
    structure_names,
    structure_values,
)
from identknee.model.parameters import STIFFNESS, STRAIN
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array, BoolArray
from identknee.runs.record import Outcome
from identknee.subject.knee import Uncertainty
from identknee.subject.ligament import Ligament, LigamentGroup
from identknee.verbs.identification import Identification, identification

N_REPLICATES = 4
NOISE, FORCE_SD, INSERTIONS_MM = 0.5, 5.0, 2.0
# The model's bundles, those of a line by their numbers: 18 ligaments, as many as the paper has.
LINES: dict[str, tuple[str, tuple[int, ...]]] = {
    "ACLam": ("ACLam", (1, 2, 3, 4, 5, 6)),
    "ACLpl": ("ACLpl", (1, 2, 3, 4, 5, 6)),
    "PCLal": ("PCLal", (1, 2, 3, 4, 5)),
    "PCLpm": ("PCLpm", (1, 2, 3, 4, 5)),
    "LCLa": ("LCL", (3, 4)),
    "LCLp": ("LCL", (1, 2)),
    "PFLa": ("PFL", (3, 4, 5)),
    "PFLp": ("PFL", (1, 2)),
    "sMCLa": ("MCLs", (1, 2)),
    "sMCLm": ("MCLs", (5, 6)),
    "sMCLp": ("MCLs", (3, 4)),
    "dMCLa": ("MCLd", (2, 3)),
    "dMCLp": ("MCLd", (1, 4, 5)),
    "pMCLa": ("MCLp", (2, 4)),
    "pMCLp": ("MCLp", (1, 3, 5)),
    "PMCm": ("pCAP", (1, 4)),
    "PMCl": ("pCAP", (5, 7)),
    "PLCm": ("pCAP", (6, 8)),
    "PLCl": ("pCAP", (2, 3)),
}
ACL, ACL_LINES = "ACL", ("ACLam", "ACLpl")
TESTED = ("table2", "drawer")
# Flexion and loads of trials that no calibration sees.
NOT_TESTED = tuple(
    (flexion, loads)
    for flexion in (15.0, 30.0)
    for loads in (
        {"varus_moment_Nm": -8.0, "internal_moment_Nm": 4.0},
        {"anterior_force_N": 100.0, "internal_moment_Nm": 4.0},
        {"varus_moment_Nm": 8.0, "internal_moment_Nm": -4.0},
    )
)
DIGITS = 5
HALF_WIDTH = 1.96


@dataclass(frozen=True, kw_only=True)
class Way:
    """A way to calibrate: what is measured, and what is taken for known."""

    has_force: bool = True
    insertions_are_exact: bool = False
    takes_insertions_as_exact: bool = False
    stiffness_is_off: bool = False
    fits_stiffness: bool = False


WAYS = {
    "laxity": Way(has_force=False),
    "laxity and ACL force": Way(),
    "insertions exact": Way(insertions_are_exact=True, takes_insertions_as_exact=True),
    "insertions wrong, taken as exact": Way(takes_insertions_as_exact=True),
    "stiffness wrong, taken as known": Way(stiffness_is_off=True),
    "stiffness wrong, fitted too": Way(stiffness_is_off=True, fits_stiffness=True),
}


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A simulated knee: its model, the parameters drawn, and what was measured of it."""

    model: ik.LaxityModel
    theta: Array
    laxity: ik.Laxity
    acl: MeasuredForces


def eighteen_ligaments() -> ik.Knee:
    """The OpenSim knee with its bundles merged to 18 ligaments: one has two lines, the ACL."""
    bundles = {x.name: x for x in study_knee(BUNDLES).ligaments}
    lines = []
    for name, (group, numbers) in LINES.items():
        own = [bundles[f"{group}{i}"] for i in numbers]
        stiffness = np.array([x.stiffness_kN for x in own])
        share = stiffness / stiffness.sum()
        lines.append(
            Ligament(
                name=name,
                femur=share @ np.array([x.femur for x in own]),
                tibia=share @ np.array([x.tibia for x in own]),
                stiffness_kN=float(stiffness.sum()),
                reference_strain_pct=float(share @ [x.reference_strain_pct for x in own]),
            )
        )
    knee = study_knee(BUNDLES).with_ligaments(lines)
    knee = replace(knee, groups=(LigamentGroup(name=ACL, members=ACL_LINES),))
    return knee.with_uncertainty(Uncertainty(insertions_mm=INSERTIONS_MM))


def tested() -> Protocol:
    """The trials that are measured."""
    parts = [ik.load_protocol(x) for x in TESTED]
    named = [
        replace(x, trials=tuple(f"{name}_{y}" for y in x.trials))
        for name, x in zip(TESTED, parts, strict=True)
    ]
    return concatenate(named, name="tested")


def not_tested() -> Protocol:
    """Trials under two loads at once, of which nothing is measured."""
    names = ik.laxity.LOADS
    return Protocol(
        name="not tested",
        trials=tuple(f"combined_{i}" for i in range(len(NOT_TESTED))),
        flexion_deg=np.array([x for x, _ in NOT_TESTED]),
        loads=np.array([[loads.get(name, 0.0) for name in names] for _, loads in NOT_TESTED]),
    )


def drawn(seed: int, way: Way) -> Truth:
    """A knee drawn from what is known before any test, and its measurements with noise.

    Trials in which it has no equilibrium are missing. With the same seed what is drawn for two ways
    is the same; insertions and stiffness are as stated where the way has them so.
    """
    model = ik.LaxityModel(knee=eighteen_ligaments(), protocol=tested())
    parameters = model.parameters
    generator = np.random.default_rng(seed)
    deviate = generator.normal(size=parameters.n)
    is_stiffness = np.array([x.endswith(STIFFNESS) for x in parameters.names])
    deviate[is_stiffness] *= way.stiffness_is_off
    deviate[~parameters.is_of_interest] *= not way.insertions_are_exact
    step = parameters.prior_sd * deviate
    start = parameters.start
    theta = np.where(is_stiffness, start * np.exp(np.where(is_stiffness, step, 0.0)), start + step)
    theta = np.clip(theta, parameters.lower, parameters.upper)
    prediction = model.predict(theta, derivatives=False)
    holds = np.flatnonzero(prediction.is_converged)
    noise = generator.normal(size=(2, model.protocol.n, 5))
    laxity = ik.Laxity(
        protocol=model.protocol,
        coordinates=prediction.coordinates + NOISE * noise[0],
        sd=np.full((model.protocol.n, 5), NOISE),
    )
    force = structure_values(model, prediction, ACL)[0] + FORCE_SD * noise[1, :, 0]
    measured = MeasuredForces(
        names=(f"{ACL}.tension_N",),
        values=force[holds, None],
        sd=np.full((holds.size, 1), FORCE_SD),
    )
    return Truth(model=model, theta=theta, laxity=laxity.select(holds), acl=measured)


def calibrated(task: Row) -> Row:
    """What one calibration finds of one knee, beside the truth."""
    way = WAYS[task["way"]]
    truth = drawn(task["seed"], way)
    knee = truth.model.knee
    if way.takes_insertions_as_exact:
        knee = knee.with_uncertainty(Uncertainty())
    laxity = replace(truth.laxity, forces=truth.acl) if way.has_force else truth.laxity
    known = [] if way.fits_stiffness else [f"{x}.{STIFFNESS}" for x in truth.model.tied.names]
    setup = identification(knee, laxity, fixed=known, priors=True)
    found = _fitted(setup, truth)
    at = evaluate(setup.problem, found.theta)
    covariance: Array = np.asarray(np.linalg.inv(at.jacobian.T @ at.jacobian), np.float64)
    row = {
        **task,
        "n_trials": laxity.n,
        "outcome": found.outcome.value,
        "strain_pct": _strains(truth, setup, found, covariance),
        "slack_length_mm": _slack_lengths(truth, setup, found, covariance),
        "forces_N": _forces(truth, setup, found, covariance),
    }
    return dict(rounded(row, DIGITS))


def _fitted(setup: Identification, truth: Truth) -> Fit:
    """The search from what is known before; where it ends in no minimum, or that from the truth."""
    first = fit(setup.problem, setup.start)
    if first.outcome is Outcome.MINIMUM:
        return first
    real = dict(zip(truth.model.parameters.names, truth.theta.tolist(), strict=True))
    begin = np.array([real[x] for x in setup.problem.parameters.names])
    return min(first, fit(setup.problem, begin), key=lambda x: x.objective)


def _strains(truth: Truth, setup: Identification, found: Fit, covariance: Array) -> Row:
    """True and found reference strain, its deviation, and that before any test, by ligament."""
    parameters, everything = setup.problem.parameters, truth.model.parameters
    rows = {}
    for name in truth.model.tied.names:
        i, j = parameters.index(f"{name}.{STRAIN}"), everything.index(f"{name}.{STRAIN}")
        sd = float(np.sqrt(covariance[i, i]))
        rows[name] = [truth.theta[j], found.theta[i], sd, parameters.prior_sd[i]]
    return rows


def _slack_lengths(truth: Truth, setup: Identification, found: Fit, covariance: Array) -> Row:
    """True and found slack length, its deviation, and that before any test, by ligament."""
    theta = found.theta
    here = slack_lengths(setup.model, setup.free.expand(theta))
    slopes = np.empty((here.size, theta.size))
    for i, size in enumerate(1e-4 * setup.problem.parameters.prior_sd):
        step = np.zeros(theta.size)
        step[i] = size
        ends = [slack_lengths(setup.model, setup.free.expand(theta + x)) for x in (-step, step)]
        slopes[:, i] = (ends[1] - ends[0]) / (2.0 * size)
    sd = np.sqrt(np.einsum("ip,pq,iq->i", slopes, covariance, slopes))
    before = np.sqrt((slopes**2) @ setup.problem.parameters.prior_sd_in_own_units**2)
    columns = np.column_stack([slack_lengths(truth.model, truth.theta), here, sd, before])
    return dict(zip(truth.model.tied.names, columns.tolist(), strict=True))


def slack_lengths(model: ik.LaxityModel, theta: Array) -> Array:
    """Slack length of each ligament [mm]; of the ACL the mean weighted by stiffness."""
    knee, names = model.knee, model.parameters.names
    values = dict(zip(names, theta.tolist(), strict=True))
    axes = {"femur": knee.femur_frame.axes, "tibia": knee.tibia_frame.axes}
    units = model.tied
    strain = units.strain(theta[units.n : 2 * units.n])
    length = []
    for line, own in zip(knee.ligaments, strain, strict=True):
        ends = [
            getattr(line, bone)
            + np.array([values.get(f"insertion.{line.name}_{bone}_{x}_mm", 0.0) for x in "xyz"])
            @ axes[bone]
            for bone in axes
        ]
        length.append(float(np.linalg.norm(ends[0] - ends[1])) / (1.0 + 0.01 * own))
    stiffness = np.array([x.stiffness_kN for x in knee.ligaments])
    lines = [x.name for x in knee.ligaments]
    slack = []
    for name in units.names:
        own = np.array([x == name or (name == ACL and x in ACL_LINES) for x in lines])
        slack.append(float(np.average(np.array(length)[own], weights=stiffness[own])))
    return np.array(slack)


def _forces(truth: Truth, setup: Identification, found: Fit, covariance: Array) -> Row:
    """How well forces are predicted: of the ACL and all others, in trials tested and not tested."""
    theta = setup.free.expand(found.theta)
    rows: Row = {}
    for where, protocol in (("tested", truth.laxity.protocol), ("not tested", not_tested())):
        true = truth.model.with_protocol(protocol).predict(truth.theta, derivatives=False)
        model = setup.model.with_protocol(protocol)
        prediction = model.predict(theta)
        loads = structure_loads(model, prediction)
        before = model.predict(setup.free.expand(setup.start), derivatives=False)
        holds = true.is_converged & prediction.is_converged
        for who in (ACL, "others"):
            names = [x for x in truth.model.tied.names if (x == ACL) == (who == ACL)]
            real = _tensions(truth.model.with_protocol(protocol), true, names)
            prior = _tensions(model, before, names)
            both = holds & before.is_converged
            rows[f"{who}, {where}"] = {
                **_score(real, loads, setup, names, covariance, holds),
                "rms_before": float(np.sqrt(np.mean((prior - real)[both] ** 2))),
                "n_lost": int(protocol.n - holds.sum()),
            }
    return rows


def _tensions(model: ik.LaxityModel, prediction: Prediction, names: list[str]) -> Array:
    return np.column_stack([structure_values(model, prediction, x)[0] for x in names])


def _score(
    real: Array,
    loads: StructureLoads,
    setup: Identification,
    names: list[str],
    covariance: Array,
    holds: BoolArray,
) -> Row:
    """Errors of predicted forces, and the share within their 95 % intervals to first order."""
    columns = [structure_names(setup.model).index(x) for x in names]
    slopes = setup.free.restrict(loads.tension_jacobian)[:, columns]
    sd = np.sqrt(np.einsum("tlp,pq,tlq->tl", slopes, covariance, slopes))
    off = (loads.tensions[:, columns] - real)[holds]
    return {
        "n": int(off.size),
        "rms": float(np.sqrt(np.mean(off**2))),
        "largest": float(np.abs(off).max()),
        "rms_true": float(np.sqrt(np.mean(real[holds] ** 2))),
        "n_within": int((np.abs(off) <= HALF_WIDTH * sd[holds] + 1e-9).sum()),
    }
