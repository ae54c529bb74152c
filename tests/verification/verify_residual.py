"""The force left over in every trial that is said to have converged."""

import argparse

import numpy as np
import oracle
from energy_evaluation import oracle_of
from knees import SCALE, anywhere, model, trial_energy
from oracle import State
from requirement_rows import Row, largest_of

from identknee.checks.subject_checks import box_sample
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

BAR = 1e-6  # N, moments divided by 40 mm
VECTORS = 150
BY_ORACLE = 8


def measure(options: argparse.Namespace) -> Row:
    """At the subjects' own parameters and at random ones, near and anywhere in the box."""
    measures = []
    slow_residuals = []
    for name in ("reference", "lenhart2015_stable", "lenhart2015"):
        subject = model(name)
        generator = np.random.default_rng(3)
        vectors = [
            subject.parameters.center,
            *box_sample(subject.parameters, VECTORS, generator),
            *anywhere(subject.parameters, VECTORS, generator),
        ]
        left = [x for theta in vectors for x in _residuals(subject, theta)]
        measures.append(largest_of(f"{name}, trials of {len(vectors)} vectors", left, "N", bar=BAR))
        slow_residuals += _by_oracle(subject, vectors[1], generator)
    measures.append(largest_of("by the slow oracle", slow_residuals, "N", bar=BAR))
    return Row(
        line="equilibrium residual <= 1e-6 N (N mm / 40 mm for moments) in every converged trial",
        measures=measures,
    )


def _residuals(of: LaxityModel, theta: Array) -> list[float]:
    prediction = of.predict(theta, derivatives=False)
    found = []
    for trial in np.flatnonzero(prediction.is_converged):
        gradient = trial_energy(of, theta, int(trial)).raw(prediction.poses[trial])[1]
        found.append(float(np.linalg.norm(gradient / SCALE)))
    return found


def _by_oracle(of: LaxityModel, theta: Array, generator: np.random.Generator) -> list[float]:
    slow = oracle_of(of.joint)
    prediction = of.predict(theta, derivatives=False)
    m = len(theta) // 2
    found = []
    for trial in generator.permutation(np.flatnonzero(prediction.is_converged))[:BY_ORACLE]:
        node = of.paths.trial_node[trial]
        state = State(
            flexion=float(of.paths.flexion[node]),
            load=of.paths.loads[node].tolist(),
            stiffness=(1000.0 * theta[:m]).tolist(),
            strain=(0.01 * theta[m:]).tolist(),
        )
        gradient = np.array(oracle.gradient(slow, state, prediction.poses[trial].tolist()))
        found.append(float(np.linalg.norm(gradient / SCALE)))
    return found
