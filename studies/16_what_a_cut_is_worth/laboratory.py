"""What the laboratory of a measured knee could have done: its own trials, simulated cuts."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from common.records import Row, rounded

import identknee as ik
from identknee.calibrate.problem import ParameterQuantity, RestrictedQuantity
from identknee.identify.profile.profile import profile_quantities
from identknee.laxity.experiments import Experiment
from identknee.laxity.forces import MeasuredForces
from identknee.laxity.protocol import Protocol, concatenate, dominant_loads
from identknee.model.candidate_laxity import CONTACT_SD, TENSION_SD, continued_from_own_poses
from identknee.model.contact_loads import contact_values
from identknee.model.line_loads import structure_values
from identknee.model.prediction import Prediction
from identknee.model.quantities import quantity_named
from identknee.runs.declare import Array
from identknee.subject.knee import EffectChoice, Uncertainty
from identknee.verbs.fitted_knee import knee_as_fitted
from identknee.verbs.identification import Identification, identification

KNEE, TABLE = "s192803", "s192803"
WRONG_ROW = "Valgus_60"
LIGAMENTS = ("ACL", "PCL", "LCL", "MCL")
NOISE = "1mm,1.5deg"
NOISE_MM, NOISE_DEG = 1.0, 1.5
UNCERTAIN_IN_FIT = "registration=4deg,registration=4mm,insertions=4mm"
STATED: Mapping[str, float] = {
    "insertions_mm": 4.0,
    "registration_deg": 4.0,
    "registration_mm": 4.0,
    "zero_mm": 1.0,
    "zero_deg": 1.0,
}
# What a plan does beside or in place of the second pass of the trials.
TENSION, CONTACT = "tension", "contact"
RIG = "robot"
# A robot does not read the same flexion twice [deg].
READ_APART_DEG = 0.05
DIGITS = 5
HALF_WIDTH = 1.96


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Two passes of the trials: states, what is measured in the second, what is known better."""

    second: str = "intact"
    # The state of the second pass at every other flexion angle; as `second` if empty.
    last: str = ""
    measured: str = ""
    known: Mapping[str, float] | None = None


PLANS: Mapping[str, Plan] = {
    "intact": Plan(),
    "ACL cut": Plan(second="cut: ACL"),
    "ACL, then PCL cut": Plan(second="cut: ACL", last="cut: ACL, PCL"),
    "in-situ forces": Plan(measured=TENSION),
    "contact forces": Plan(measured=CONTACT),
    "mounted once": Plan(known={"zero_mm": 0.0, "zero_deg": 0.0}),
    "frames known to 2 mm, 2 deg": Plan(known={"registration_mm": 2.0, "registration_deg": 2.0}),
    "insertions known to 2 mm": Plan(known={"insertions_mm": 2.0}),
}
LATER = (30, 90)


def found_knee(task: Row) -> Row:
    """The knee of four lines that fits the measured table with limits and priors."""
    found = ik.fit(
        ik.example(task["knee"]),
        measured_table(),
        noise=NOISE,
        uncertain=UNCERTAIN_IN_FIT,
        plausible="default",
        priors=True,
    )
    theta = dict(zip(found.search.parameters.names, found.search.theta.tolist(), strict=True))
    return {**task, "outcome": found.outcome.value, "theta": theta}


def measured_table() -> ik.Laxity:
    """The robot's table, the row that cannot be right blank."""
    laxity = ik.example_laxity(TABLE)
    coordinates = np.array(laxity.coordinates)
    coordinates[laxity.protocol.trials.index(WRONG_ROW)] = np.nan
    return replace(laxity, coordinates=coordinates)


def simulated_knee(theta: Mapping[str, float], known: Mapping[str, float] | None = None) -> ik.Knee:
    """The knee that was found: its ligaments, its insertions, and what of it is uncertain."""
    own = {name: x for name, x in theta.items() if name.partition(".")[0] in LIGAMENTS}
    start = "insertion."
    moved = {name.removeprefix(start): x for name, x in theta.items() if name.startswith(start)}
    knee = replace(ik.example(KNEE), fitted=own)
    knee = knee_as_fitted(knee.with_effects([EffectChoice(name="insertion", values=moved)]))
    stated: Any = {**STATED, **(known or {})}
    return replace(knee, fitted={}).with_uncertainty(Uncertainty(**stated))


class SimulatedLaboratory:
    """The trials of the laboratory as the knee that was found answers them."""

    def __init__(self, theta: Mapping[str, float]) -> None:
        laxity = measured_table()
        sound = laxity.select(np.flatnonzero(laxity.is_measured.all(axis=1)))
        model = ik.LaxityModel(knee=simulated_knee(theta), protocol=sound.protocol)
        self._model = model.with_tests(sound)
        self.trials = sound.protocol

    def made(self, protocol: Protocol) -> tuple[ik.LaxityModel, Prediction]:
        """The model under trials, and what it predicts of them.

        Trials whose pose was never measured are followed under growing loads, as `design` does.
        """
        model = self._model.with_protocol(protocol)
        names = {x.partition(", ")[0] for x in protocol.trials}
        if not names <= set(self.trials.trials):
            model = continued_from_own_poses(model, model.parameters.start)
        return model, model.predict(model.parameters.start, derivatives=False)

    def measured(self, protocol: Protocol, what: str = "") -> ik.Laxity:
        """Laxity without noise, and forces; trials that do not hold are missing."""
        model, found = self.made(protocol)
        sd = np.tile([NOISE_MM] * 3 + [NOISE_DEG] * 2, (protocol.n, 1))
        laxity = ik.Laxity(protocol=protocol, coordinates=found.coordinates, sd=sd)
        if what == TENSION:
            forces = {f"{x}.tension_N": structure_values(model, found, x)[0] for x in LIGAMENTS}
            laxity = replace(laxity, forces=measured_forces(forces, TENSION_SD))
        elif what == CONTACT:
            values = contact_values(found)[:, :, 0].T
            forces = dict(zip(("contact.medial_N", "contact.lateral_N"), values, strict=True))
            laxity = replace(laxity, forces=measured_forces(forces, CONTACT_SD))
        return laxity.select(np.flatnonzero(found.is_converged))

    def strongest(self) -> dict[str, str]:
        """Of each ligament the trial of the intact knee in which it pulls hardest."""
        model, found = self.made(self.trials)
        tension = {x: structure_values(model, found, x)[0] for x in LIGAMENTS}
        return {x: self.trials.trials[int(np.nanargmax(y))] for x, y in tension.items()}


def measured_forces(values: Mapping[str, Array], sd: float) -> MeasuredForces:
    """Forces of all trials with one standard deviation."""
    found = np.column_stack(list(values.values()))
    spread = np.where(np.isnan(found), np.nan, sd)
    return MeasuredForces(names=tuple(values), values=found, sd=spread)


def one_pass(protocol: Protocol, number: int, states: tuple[str, ...]) -> Protocol:
    """The trials once, as an experiment with a mounting of its own."""
    name = f"pass {number}"
    return replace(
        protocol,
        name=name,
        trials=tuple(f"{x}, {name}" for x in protocol.trials),
        flexion_deg=protocol.flexion_deg + READ_APART_DEG * (number - 1),
        state=states,
        experiment=(name,) * protocol.n,
        experiments=(Experiment(name=name, rig=RIG, mounting=name),),
    )


def planned(laboratory: SimulatedLaboratory, plan: Plan) -> ik.Laxity:
    """What a plan measures."""
    protocol = laboratory.trials
    angles = [int(x.rpartition("_")[2]) for x in protocol.trials]
    second = tuple(plan.last or plan.second if x in LATER else plan.second for x in angles)
    passes = [("intact",) * protocol.n, second]
    parts = [
        laboratory.measured(one_pass(protocol, i + 1, states), plan.measured if i else "")
        for i, states in enumerate(passes)
    ]
    return joined(parts)


def joined(parts: list[ik.Laxity]) -> ik.Laxity:
    """Several tables as one."""
    names = tuple(dict.fromkeys(y for x in parts if x.forces is not None for y in x.forces.names))
    sizes = [(x.n, len(names)) for x in parts]
    forces = None
    if names:
        forces = MeasuredForces(
            names=names,
            values=np.vstack(
                [_columns(x.forces, "values", names, y) for x, y in zip(parts, sizes, strict=True)]
            ),
            sd=np.vstack(
                [_columns(x.forces, "sd", names, y) for x, y in zip(parts, sizes, strict=True)]
            ),
        )
    return ik.Laxity(
        protocol=concatenate([x.protocol for x in parts], name="plan"),
        coordinates=np.vstack([x.coordinates for x in parts]),
        sd=np.vstack([x.sd for x in parts if x.sd is not None]),
        forces=forces,
    )


def _columns(
    forces: MeasuredForces | None, what: str, names: tuple[str, ...], shape: tuple[int, int]
) -> Array:
    found = np.full(shape, np.nan)
    if forces is not None:
        found[:, [names.index(x) for x in forces.names]] = getattr(forces, what)
    return found


def plan_row(task: Row) -> Row:
    """Intervals of all parameters, and of each ligament's largest force, after one plan."""
    laboratory, plan = SimulatedLaboratory(task["theta"]), PLANS[task["plan"]]
    laxity = planned(laboratory, plan)
    asked = [f"{x}.tension_N@{y}, pass 1" for x, y in laboratory.strongest().items()]
    found = intervals(simulated_knee(task["theta"], plan.known), laxity, asked)
    return dict(rounded({"plan": task["plan"], "n_trials": laxity.n, **found}, DIGITS))


def intervals(
    knee: ik.Knee, laxity: ik.Laxity, asked: list[str], names: list[str] | None = None
) -> Row:
    """95 % intervals about the truth, where laxity without noise has its best fit.

    Those of parameters are profiled, those of forces are of first order.
    """
    setup = identification(knee, laxity)
    if setup.trials_used != laxity.protocol.trials:
        raise AssertionError(set(laxity.protocol.trials) - set(setup.trials_used))
    parameters = setup.problem.parameters
    names = names or list(parameters.names_of_interest)
    profiles = profile_quantities(
        setup.problem,
        setup.start,
        [ParameterQuantity(parameters=parameters, name=x) for x in names],
        starts=(),
    )
    covariance = _covariance(setup)
    return {
        "deviance": float(np.sum(setup.problem.residuals(setup.start) ** 2)),
        "ends": {x.name: [x.lower, x.upper] for x in profiles},
        "forces": {x: _force(setup, x, covariance) for x in asked},
    }


def _covariance(setup: Identification) -> Array:
    """Covariance of all parameters to first order; one without a prior lies within its bounds."""
    parameters = setup.problem.parameters
    slopes = setup.problem.jacobian(setup.start)
    weak = np.diag(np.sqrt(12.0) / (parameters.upper - parameters.lower))
    rows = np.vstack([slopes, weak[parameters.is_of_interest]])
    return np.asarray(np.linalg.inv(rows.T @ rows))


def _force(setup: Identification, name: str, covariance: Array) -> list[float]:
    """A force and the ends of its 95 % interval to first order."""
    quantity = RestrictedQuantity(quantity=quantity_named(setup.model, name), free=setup.free)
    value, slope = quantity.evaluate(setup.start)
    half = HALF_WIDTH * float(np.sqrt(slope @ covariance @ slope))
    return [float(value), float(value) - half, float(value) + half]


def advice_row(task: Row) -> Row:
    """What `design` ranks before there are data: the best single step of each kind.

    Of cuts and forces also the best of each structure.
    """
    laboratory = SimulatedLaboratory(task["theta"])
    knee = simulated_knee(task["theta"])
    names = [f"{x}.{y}" for y in ("stiffness_kN", "reference_strain_pct") for x in LIGAMENTS]
    found = ik.design(knee, protocol=laboratory.trials, noise=NOISE, n_trials=1, targets=names)
    best: dict[str, Row] = {}
    of_structures: dict[str, Row] = {}
    for row in found.choice.ranking:
        step = {**row, **_described(found, row)}
        best.setdefault(row["kind"], step)
        if structure := step.get("structure"):
            kept = {x: step[x] for x in ("kind", "structure", "name", "narrowing")}
            of_structures.setdefault(f"{row['kind']} {structure}", kept)
    return {
        "trials_used": list(found.trials_used),
        "steps": rounded(list(best.values()), DIGITS),
        "of_structures": rounded(list(of_structures.values()), DIGITS),
    }


def _described(found: ik.Design, row: Mapping[str, Any]) -> Row:
    """What a step needs to be made: the structure, and the trial with its loads."""
    if row["kind"] == "error":
        return {}
    step = next((x for x in found.choice.steps if x.name == row["name"]), None)
    trial = row["name"] if step is None else step.trial
    place = found.choice.names.index(trial)
    return {
        "structure": "" if step is None else step.structure,
        "flexion_deg": float(found.flexion_deg[place]),
        "loads": found.loads[place].tolist(),
    }


def step_row(task: Row) -> Row:
    """Intervals of all parameters once a single step was made after one pass; none for none."""
    laboratory, step = SimulatedLaboratory(task["theta"]), task["step"]
    trials, knee = laboratory.trials, simulated_knee(task["theta"])
    kind = step.get("kind", "")
    parts = [laboratory.measured(trials)]
    if kind == "error":
        knee = knee.with_uncertainty(halved(knee, step["name"]))
    elif kind in ("trial", "cut"):
        state = "intact" if kind == "trial" else f"cut: {step['structure']}"
        parts.append(laboratory.measured(_trial(step, state)))
    elif kind:
        parts = [_with_force(laboratory, step)]
    found = intervals(knee, joined(parts), [])
    return dict(rounded({"name": step.get("name", ""), "kind": kind, **found}, DIGITS))


def halved(knee: ik.Knee, name: str) -> Uncertainty:
    """What is stated of the knee, one error known twice as well.

    The name is that of an insertion, such as ``insertion.ACL_femur``, or of the frames.
    """
    stated = knee.uncertainty
    kind, _, place = name.partition(".")
    if kind != "insertion":
        raise ValueError(f"halve {name} by hand: only insertions are known here")
    spreads = {x: {"femur": 4.0, "tibia": 4.0} for x in LIGAMENTS}
    ligament, bone = place.split("_")
    spreads[ligament][bone] = 2.0
    return replace(stated, insertions_mm=spreads)


def _trial(step: Row, state: str) -> Protocol:
    return Protocol(
        name="step",
        trials=(step["name"],),
        flexion_deg=np.array([step["flexion_deg"]]),
        loads=np.array([step["loads"]]),
        state=(state,),
    )


def _with_force(laboratory: SimulatedLaboratory, step: Row) -> ik.Laxity:
    """The pass with the force of the step in the trial that is most like the one meant."""
    trials = laboratory.trials
    own, meant = dominant_loads(trials), dominant_loads(_trial(step, "intact"))
    like = (own.axis == meant.axis[0]) & (np.sign(own.size) == np.sign(meant.size[0]))
    apart = np.where(like, np.abs(trials.flexion_deg - step["flexion_deg"]), np.inf)
    kind = TENSION if step["kind"] == "force" else CONTACT
    laxity = laboratory.measured(trials, kind)
    if laxity.forces is None:
        raise AssertionError
    is_asked = np.zeros(laxity.forces.values.shape, bool)
    is_asked[int(np.argmin(apart))] = [
        kind == CONTACT or x == f"{step['structure']}.tension_N" for x in laxity.forces.names
    ]
    values, sd = (np.where(is_asked, x, np.nan) for x in (laxity.forces.values, laxity.forces.sd))
    kept = np.atleast_1d(is_asked.any(axis=0))
    forces = MeasuredForces(
        names=tuple(x for x, y in zip(laxity.forces.names, kept, strict=True) if y),
        values=values[:, kept],
        sd=sd[:, kept],
    )
    return replace(laxity, forces=forces)
