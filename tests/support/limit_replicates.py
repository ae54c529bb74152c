"""How far the deviance rises to the truth where ligaments of the specimen did not fail."""

from dataclasses import replace
from typing import Any

import numpy as np
from experiment_replicates import NOISE, STATED, drawn_truth, rises_to_truth
from knees import knee

import identknee as ik
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import Prediction
from identknee.runs.arrays import Array
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
    trials = ik.load_protocol("seed63")
    model = LaxityModel(knee=known, protocol=trials.select(range(0, trials.n, EVERY)))
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
    names = [x.name for x in model.knee.ligaments]
    owners = [names.index(x.what.partition(".")[0]) for x in limits]
    for _ in range(MOST_SPECIMENS):
        theta, found = drawn_truth(model, generator, model.protocol.n)
        strengths = np.array([generator.normal(x.size, x.spread) for x in limits])
        if found.is_converged.all() and np.all(_largest(model, found)[owners] < strengths):
            return theta, found
    raise AssertionError("no knee bears these trials")


def _largest(model: LaxityModel, found: Prediction) -> Array:
    """The largest tension of each ligament over the trials [N]."""
    return np.asarray(np.nanmax(tensions_of(model, found), axis=0))
