"""Exact sensitivities against differences of equilibria solved again."""

import argparse

import numpy as np
from knees import model
from requirement_rows import Row, largest_of

from identknee.checks.subject_checks import box_sample
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

BAR = 1e-5
VECTORS = 6
STEP_KN, STEP_PCT = 2e-3, 1e-3
# A kink, where a point enters or leaves contact, shows in the differences alone: those with a step
# and with half of it then disagree.
KINK = 2e-6
# A column below this, in mm or deg per kN or %, belongs to a slack ligament.
SLACK = 1e-6


def measure(options: argparse.Namespace) -> Row:
    """Errors of a trial's five coordinates by one parameter, over the size of that column."""
    measures, notes = [], []
    for name in ("reference", "lenhart2015_stable"):
        subject = model(name)
        generator = np.random.default_rng(2)
        vectors = [subject.parameters.center, *box_sample(subject.parameters, VECTORS, generator)]
        errors, slack, kinks = [], [], 0
        for theta in vectors:
            some, none, n = _errors(subject, theta)
            errors += some
            slack += none
            kinks += n
        measures.append(largest_of(name, errors, "relative", bar=BAR))
        total = len(errors) + kinks
        notes.append(
            f"{name}: {kinks} of {total} columns left out, as their differences with a step and "
            f"with half of it disagree (a kink); {len(slack)} columns of slack ligaments are off "
            f"by at most {max(slack, default=0.0):.1g} mm or deg per kN or %"
        )
    return Row(
        line="sensitivities against differences of re-solved equilibria (away from kinks): "
        "1e-5 relative",
        measures=measures,
        notes=notes,
    )


def _errors(of: LaxityModel, theta: Array) -> tuple[list[float], list[float], int]:
    at = of.predict(theta)
    if at.jacobian is None:
        raise AssertionError
    m = of.parameters.n // 2
    errors: list[float] = []
    slack: list[float] = []
    kinks = 0
    for k in range(of.parameters.n):
        step = STEP_KN if k < m else STEP_PCT
        coarse, fine = _difference(of, theta, k, step), _difference(of, theta, k, step / 2)
        for exact, one, two in zip(at.jacobian[:, :, k], coarse, fine, strict=True):
            if np.isnan(exact).any() or np.isnan(one).any() or np.isnan(two).any():
                continue
            size = np.linalg.norm(two)
            if size < SLACK:
                slack.append(float(np.abs(exact - two).max()))
            elif np.linalg.norm(one - two) > KINK * size:
                kinks += 1
            else:
                errors.append(float(np.linalg.norm(exact - two) / size))
    return errors, slack, kinks


def _difference(of: LaxityModel, theta: Array, k: int, step: float) -> Array:
    """Central difference of fourth order, shape ``(n, 5)``."""

    def at(steps: int) -> Array:
        moved = np.array(theta)
        moved[k] += steps * step
        return of.predict(moved, derivatives=False).coordinates

    return (8.0 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12.0 * step)
