"""Predictions started from another one against those from the scanned pose, in any order."""

import argparse

import numpy as np
from knees import model
from requirement_rows import Measure, Row, largest_of

from identknee.checks.subject_checks import box_sample
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array

BAR = 1e-9  # mm or deg
ENOUGH_MARGIN = 0.5  # N/mm
VECTORS = 400
ORDERS = 3


def measure(options: argparse.Namespace) -> Row:
    """Random orders of random vectors, each started from the one before, near or far."""
    measures = []
    for name in ("reference", "lenhart2015_stable"):
        subject = model(name)
        generator = np.random.default_rng(4)
        center = subject.parameters.center
        wide = box_sample(subject.parameters, VECTORS // 2, generator)
        # Half of them a short step from the subject's own, as within a fit.
        close = center + 0.05 * (box_sample(subject.parameters, VECTORS // 2, generator) - center)
        vectors = np.concatenate([wide, close])
        cold = [subject.predict(theta, derivatives=False) for theta in vectors]
        differences: list[float] = []
        disagreeing = 0
        for order in range(ORDERS):
            chain = generator.permutation(len(vectors))
            if order == ORDERS - 1:
                chain = np.arange(len(vectors))
            for index, warm in zip(chain, _chained(subject, vectors[chain]), strict=True):
                same, other = _compare(cold[index], warm)
                differences += same
                disagreeing += other
        measures += [
            largest_of(f"{name}, margin >= 0.5 N/mm", differences, "mm or deg", bar=BAR),
            Measure(
                what=f"{name}, trials with another outcome",
                value=disagreeing,
                unit="",
                bar=0,
                count=ORDERS * len(vectors) * subject.protocol.n,
            ),
        ]
    return Row(
        line="cold path against warm path, any order of evaluation: same to 1e-9 where the "
        "stability margin is >= 0.5 N/mm",
        measures=measures,
    )


def _chained(of: LaxityModel, vectors: Array) -> list[Prediction]:
    found: list[Prediction] = []
    for theta in vectors:
        before = found[-1] if found else None
        found.append(of.predict(theta, derivatives=False, near=before))
    return found


def _compare(cold: Prediction, warm: Prediction) -> tuple[list[float], int]:
    firm = (cold.margins >= ENOUGH_MARGIN) | (warm.margins >= ENOUGH_MARGIN)
    both = cold.is_converged & warm.is_converged & firm
    difference = np.abs(cold.coordinates[both] - warm.coordinates[both])
    # A margin says something of a pose that stands; one that ended a branch has none to speak of.
    other = (cold.is_converged != warm.is_converged) & firm
    return difference.max(axis=1, initial=0.0).tolist(), int(other.sum())
