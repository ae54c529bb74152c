"""Knees whose geometry is assumed a little wrong, and how far the truth is from the best fit."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

import identknee as ik
from common.problems import model_of, truth_of
from common.records import Row

MOMENTS = (ik.laxity.LOADS.index("varus_moment_Nm"), ik.laxity.LOADS.index("internal_moment_Nm"))


class TrueSetting:
    """The knee as it is, its parameters, and its largest ligament forces.

    Attributes
    ----------
    model
        The model under the 63 trials.
    truth
        True theta, shape ``(p,)``.
    tensions
        Tension of every ligament in every trial [N], shape ``(n, m)``.
    peaks
        Name of each ligament, and the trial that loads it most.
    peak_forces
        The forces there [N], shape ``(m,)``.
    """

    def __init__(self, knee: ik.Knee) -> None:
        self.model = model_of(knee)
        self.truth = truth_of(self.model.parameters)
        self.tensions = ik.model.tensions_of(self.model, self.model.predict(self.truth))
        most = self.tensions.argmax(axis=0)
        self.peaks = [
            (ligament.name, self.model.protocol.trials[trial])
            for ligament, trial in zip(knee.ligaments, most, strict=True)
        ]
        self.peak_forces = self.tensions.max(axis=0)


@cache
def true_setting(knee: ik.Knee) -> TrueSetting:
    """The setting of a knee, made once in each process."""
    return TrueSetting(knee)


def with_error(
    knee: ik.Knee, protocol: ik.Protocol, task: Row, generator: np.random.Generator
) -> tuple[ik.Knee, ik.Protocol]:
    """The geometry assumed in the fit, and the loads really applied."""
    size = float(task["size"])
    if task["kind"] == "insertions":
        moved = [
            replace(
                x,
                femur=x.femur + generator.normal(0.0, size, 3),
                tibia=x.tibia + generator.normal(0.0, size, 3),
            )
            for x in knee.ligaments
        ]
        return knee.with_ligaments(moved), protocol
    axis = generator.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(size) * axis / np.linalg.norm(axis)).as_matrix()
    if task["kind"] == "tibial frame":
        frame = ik.subject.Frame(origin=knee.tibia_frame.origin, axes=turn @ knee.tibia_frame.axes)
        return replace(knee, tibia_frame=frame), protocol
    loads = np.array(protocol.loads)
    # About floating axis and tibial axis; what falls on the flexion axis is held by the rig.
    loads[:, MOMENTS] = loads[:, MOMENTS] @ turn[:2, :2].T
    return knee, replace(protocol, loads=loads)


def constrained_deviances(
    evaluator: ik.calibrate.Evaluator,
    best: ik.calibrate.ConstrainedFit,
    wanted: Sequence[tuple[ik.calibrate.Quantity, float]],
) -> tuple[list[float], ik.calibrate.ConstrainedFit]:
    """Lowest deviance with each quantity at its true value, and the best fit seen on the way."""
    deviances = []
    for quantity, target in wanted:
        start = best.evaluation.theta
        found = ik.calibrate.solve_constrained(evaluator, start, quantity=quantity, target=target)
        reached = found.is_on_target and found.evaluation.is_finite
        deviances.append(found.evaluation.deviance if reached else np.inf)
        if reached and found.evaluation.deviance < best.evaluation.deviance:
            again = ik.calibrate.minimise(evaluator, found.evaluation.theta)
            if again.evaluation.deviance < best.evaluation.deviance:
                best = again
    return deviances, best
