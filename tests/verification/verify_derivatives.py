"""The kernel's gradient, Hessian and slope with flexion against complex steps of the oracle."""

import argparse

import numpy as np
import oracle
from energy_evaluation import oracle_of
from knees import SCALE, anywhere, model, trial_energy
from oracle import State
from requirement_rows import Row, largest_of

from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

POSES = 12
BAR = 1e-8
STEP = 1e-30


def measure(options: argparse.Namespace) -> Row:
    """Relative errors at equilibria and up to 0.5 mm and 0.7 deg beside them."""
    errors: dict[str, list[float]] = {"gradient": [], "Hessian": [], "d gradient / d flexion": []}
    touching = []
    for name in ("reference", "lenhart2015_stable"):
        for found, n in _errors(model(name), np.random.default_rng(1)):
            touching.append(n)
            for kind, error in found.items():
                errors[kind].append(error)
    return Row(
        line="gradient and Hessian against complex-step differences: 1e-8 relative",
        measures=[largest_of(kind, values, "relative", bar=BAR) for kind, values in errors.items()],
        notes=[
            f"{min(touching)} to {max(touching)} contact points",
            "an imaginary step of 1e-30 crosses neither a cell's face nor a contact's onset",
            "the largest error of an entry over the largest entry, angles times 40 mm",
        ],
    )


def _errors(of: LaxityModel, generator: np.random.Generator) -> list[tuple[dict[str, float], int]]:
    slow = oracle_of(of.joint)
    own = of.predict(of.parameters.center, derivatives=False)
    trials = generator.choice(of.protocol.n, POSES, replace=False)
    found = []
    for trial, theta in zip(trials, anywhere(of.parameters, POSES, generator), strict=True):
        aside = generator.uniform(-0.5, 0.5, 5) / SCALE
        pose = own.poses[trial] + aside
        fast = trial_energy(of, theta, int(trial))
        _, g, H, h = fast.raw(pose)
        m = len(theta) // 2
        state = State(
            flexion=fast.flexion,
            load=fast.load.tolist(),
            stiffness=(1000.0 * theta[:m]).tolist(),
            strain=(0.01 * theta[m:]).tolist(),
        )
        place = pose.tolist()
        slope = np.array(oracle.gradient_by_complex_step(slow, state, place))
        curvature = np.array(oracle.hessian(slow, state, place))
        flexed = State(
            flexion=fast.flexion + 1j * STEP,  # type: ignore[arg-type]
            load=state.load,
            stiffness=state.stiffness,
            strain=state.strain,
        )
        by_flexion = np.array([x.imag / STEP for x in oracle.gradient(slow, flexed, place)])
        errors = {
            "gradient": _relative(g / SCALE, slope / SCALE),
            "Hessian": _relative(H / np.outer(SCALE, SCALE), curvature / np.outer(SCALE, SCALE)),
            "d gradient / d flexion": _relative(h / SCALE, by_flexion / SCALE),
        }
        found.append((errors, fast.n_touching))
    return found


def _relative(found: Array, expected: Array) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())
