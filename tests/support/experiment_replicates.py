"""How far the deviance rises to the truth where a knee is tested intact, cut, and with forces."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from coverage_replicates import FREE_TOLERANCE, held_at_truth
from knees import knee
from sbc_replicates import MOST_REDRAWN, ranked

import identknee as ik
from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import Evaluator
from identknee.identify.posterior.posterior import prior_draws
from identknee.laxity.experiment_tables import joined
from identknee.laxity.experiments import Experiment
from identknee.laxity.forces import MeasuredForces
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.quantities import quantity_named
from identknee.runs.declare import Array
from identknee.subject.knee import Knee, Uncertainty
from identknee.verbs.identification import Identification, identification

# A knee without its MCL keeps most trials of both knees.
STATES = {"intact": "intact", "cut": "cut: MCL", "part": "cut: LCL 50%"}
FORCES = {"ACL.tension_N": 10.0, "contact.medial_N": 20.0}
NOISE, EVERY, LOG_SD, STRAIN_SD = 0.5, 3, 0.15, 0.5
# A sample takes a thousand simulations and more, so it has fewer trials, and one force.
EVERY_SAMPLED, FORCES_SAMPLED = 13, {"ACL.tension_N": 10.0}
STATED = Uncertainty(insertions_mm=2.0)
MOST_DRAWS, MOST_ROUNDS, WORTH = 50, 4, 0.01


def experiment_replicate(task: tuple[str, int]) -> dict[str, Any]:
    """The rise of the profile deviance to each true ligament parameter, and the misfit."""
    subject, seed = task
    known = knee(subject).with_uncertainty(STATED)
    laxity, truth = _measured(known, np.random.default_rng([seed, *subject.encode()]))
    return rises_to_truth(identification(known, laxity), truth)


def experiment_ranks(seed: int) -> dict[str, Any]:
    """Ranks of a true knee, intact and cut, among draws of its posterior; geometry is known.

    A truth that loses a trial is drawn again: the posterior gives such parameters no likelihood,
    so that prior and posterior are cut off alike.
    """
    model, generator = state_model(), np.random.default_rng(seed)
    for n_redrawn, truth in enumerate(prior_draws(model.parameters, MOST_REDRAWN, generator)):  # noqa: B007 - the first that is found
        found = model.predict(truth, derivatives=False)
        if found.is_converged.all():
            break
    exact = ik.Laxity(protocol=model.protocol, coordinates=found.coordinates)
    noisy = add_noise(exact, sd_mm=NOISE, sd_deg=NOISE, seed=seed)
    made = replace(noisy, forces=_forces(model, truth, generator, FORCES_SAMPLED))
    problem = identification(model.knee, made).problem
    assert problem.parameters.names == model.parameters.names
    return {"n_redrawn": n_redrawn, **ranked(problem, truth, seed)}


def state_model() -> LaxityModel:
    """The reference knee in those trials of all states that hold at its values."""
    whole = LaxityModel(knee=knee("reference"), protocol=_protocol(EVERY_SAMPLED))
    holds = whole.predict(whole.parameters.start, derivatives=False).is_converged
    held = whole.protocol.select(np.flatnonzero(holds).tolist())
    return LaxityModel(knee=whole.knee, protocol=held)


def rises_to_truth(setup: Identification, truth: Mapping[str, float]) -> dict[str, Any]:
    """The rise of the profile deviance of a question to each true ligament parameter."""
    names = setup.problem.parameters.names
    asked = setup.problem.parameters.names_of_interest
    at_truth = np.array([truth[x] for x in names])
    evaluator = Evaluator(setup.problem)
    starts = [np.array(setup.start), at_truth]
    for _ in range(MOST_ROUNDS):
        fits = [minimise(evaluator, x, tolerance=FREE_TOLERANCE) for x in starts]
        free = min(fits, key=lambda x: x.evaluation.deviance)
        held = [held_at_truth(evaluator, free, name, at_truth) for name in asked]
        lowest = min([free, *held], key=lambda x: x.evaluation.deviance)
        deviance = lowest.evaluation.deviance
        if deviance > free.evaluation.deviance - WORTH:
            break
        starts = [lowest.evaluation.theta]
    return {
        "rises": [x.evaluation.deviance - deviance if x.is_on_target else np.inf for x in held],
        "n_simulations": evaluator.n_simulations,
        "n_values": setup.laxity.n_values,
        "deviance": deviance,
    }


def drawn_truth(
    model: LaxityModel, generator: np.random.Generator, n_needed: int
) -> tuple[Array, Prediction]:
    """Parameters drawn around those of a model, at which its first trials have an equilibrium."""
    p = model.parameters
    for _ in range(MOST_DRAWS):
        steps = generator.standard_normal(p.n)
        asked = np.where(p.is_log, p.start * np.exp(LOG_SD * steps), p.start + STRAIN_SD * steps)
        theta = np.where(p.is_of_interest, asked, p.center + p.prior_sd * steps)
        theta = np.clip(theta, p.lower, p.upper)
        found = model.predict(theta)
        if found.is_converged[:n_needed].all():
            break
    return theta, found


def _measured(known: Knee, generator: np.random.Generator) -> tuple[ik.Laxity, dict[str, float]]:
    """Noisy laxity and forces of a knee drawn around the one given, and its true parameters."""
    whole = LaxityModel(knee=known, protocol=_protocol())
    theta, found = drawn_truth(whole, generator, whole.protocol.n // len(STATES))
    noise = generator.normal(scale=NOISE, size=found.coordinates.shape)
    forces = _forces(whole, found.theta, generator, FORCES)
    made = ik.Laxity(
        protocol=whole.protocol,
        coordinates=found.coordinates + noise,
        sd=np.full(noise.shape, NOISE),
        forces=forces,
    )
    return made, dict(zip(whole.parameters.names, theta.tolist(), strict=True))


def _forces(
    model: LaxityModel, theta: Array, generator: np.random.Generator, sds: Mapping[str, float]
) -> MeasuredForces:
    found, trials = model.predict(theta), model.protocol.trials
    true = np.array([[quantity_named(model, f"{x}@{t}").value(found) for x in sds] for t in trials])
    sd = np.tile([*sds.values()], (len(trials), 1))
    values = true + generator.normal(scale=sd)
    return MeasuredForces(names=tuple(sds), values=values, sd=sd)


def _protocol(every: int = EVERY) -> Protocol:
    trials = ik.load_protocol("seed63")
    trials = trials.select(range(0, trials.n, every))
    tables = []
    for name, state in STATES.items():
        protocol = replace(trials, name=name, state=(state,) * trials.n)
        empty = ik.Laxity(protocol=protocol, coordinates=np.full((trials.n, 5), np.nan))
        tables.append((Experiment(name=name, rig="rig", mounting="rig-1"), empty))
    return joined(tables).protocol
