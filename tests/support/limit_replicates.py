"""How far the deviance rises to the truth where ligaments of the specimen did not fail."""

from dataclasses import replace
from typing import Any

import numpy as np
from experiment_replicates import NOISE, STATED, drawn_truth, rises_to_truth
from knees import knee
from sbc_replicates import MOST_REDRAWN, ranked

import identknee as ik
from identknee.calibrate.problem import PLAUSIBILITY_TERM, TABLE_TERM, Problem, SumOfTerms
from identknee.identify.posterior.posterior import prior_draws
from identknee.laxity.table import add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.limit_residuals import LimitResiduals
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import Prediction
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array
from identknee.subject.plausibility import Limit
from identknee.verbs.identification import identification

# Mean strength over the largest tension at the subject's values, and its deviation over specimens.
# In two of three draws some ligament would have failed: they are drawn again.
MEAN, SHARE, EVERY, MOST_SPECIMENS = 1.1, 0.15, 3, 200
LEAST_N = 20.0


def limit_replicate(task: tuple[str, int]) -> dict[str, Any]:
    """The rise of the profile deviance to each true parameter, with limits and without."""
    subject, seed = task
    known = knee(subject).with_uncertainty(STATED)
    model = LaxityModel(knee=known, protocol=_protocol())
    limits = _limits(model)
    generator = np.random.default_rng([seed, *subject.encode()])
    theta, found = _survivor(model, limits, generator)
    made = ik.Laxity(
        protocol=model.protocol,
        coordinates=found.coordinates + generator.normal(scale=NOISE, size=(model.protocol.n, 5)),
        sd=np.full((model.protocol.n, 5), NOISE),
    )
    truth = dict(zip(model.parameters.names, theta.tolist(), strict=True))
    return {
        "with": rises_to_truth(identification(replace(known, plausibility=limits), made), truth),
        "without": rises_to_truth(identification(known, made), truth),
    }


def _limits(model: LaxityModel) -> tuple[Limit, ...]:
    """Strengths of all ligaments that carry load."""
    largest = _largest(model, model.predict(model.parameters.start))
    return tuple(
        Limit(form="strength", quantity=f"{x.name}.tension_N", size=size, spread=SHARE * size)
        for x, size in zip(model.knee.ligaments, MEAN * largest, strict=True)
        if size > LEAST_N
    )


def _survivor(
    model: LaxityModel, limits: tuple[Limit, ...], generator: np.random.Generator
) -> tuple[Array, Prediction]:
    """A knee whose ligaments, their strengths drawn as well, bear all trials."""
    for _ in range(MOST_SPECIMENS):
        theta, found = drawn_truth(model, generator, model.protocol.n)
        if _survives(model, limits, found, generator):
            return theta, found
    raise AssertionError("no knee bears these trials")


def _survives(
    model: LaxityModel,
    limits: tuple[Limit, ...],
    found: Prediction,
    generator: np.random.Generator,
) -> bool:
    """Whether all trials have an equilibrium and no ligament, its strength drawn, fails in one."""
    names = [x.name for x in model.knee.ligaments]
    owners = [names.index(x.what.partition(".")[0]) for x in limits]
    strengths = np.array([generator.normal(x.size, x.spread) for x in limits])
    if not found.is_converged.all():
        return False
    return bool(np.all(_largest(model, found)[owners] < strengths))


def limit_ranks(seed: int) -> dict[str, Any]:
    """Ranks of a true knee, which is within limits that count, among draws of its posterior."""
    model = LaxityModel(knee=knee("reference"), protocol=_protocol())
    limits, generator = _limits(model), np.random.default_rng(seed)
    for n_redrawn, truth in enumerate(prior_draws(model.parameters, MOST_REDRAWN, generator)):  # noqa: B007 - the first that is found
        found = model.predict(truth, derivatives=False)
        if _survives(model, limits, found, generator):
            break
    exact = ik.Laxity(protocol=model.protocol, coordinates=found.coordinates)
    noisy = add_noise(exact, sd_mm=NOISE, sd_deg=NOISE, seed=seed)
    table = LaxityResiduals(model=model, laxity=noisy, weighting="noise")
    kept = LimitResiduals(model=table.model, limits=limits)
    terms: dict[str, Problem] = {TABLE_TERM: table, PLAUSIBILITY_TERM: kept}
    problem = SumOfTerms(terms=terms, sizes=(noisy.n_values, kept.n))
    return {"n_redrawn": n_redrawn, **ranked(problem, truth, seed)}


def _protocol() -> ik.Protocol:
    trials = ik.load_protocol("seed63")
    return trials.select(range(0, trials.n, EVERY))


def _largest(model: LaxityModel, found: Prediction) -> Array:
    """The largest tension of each ligament over the trials [N]."""
    return np.asarray(np.nanmax(tensions_of(model, found), axis=0))
