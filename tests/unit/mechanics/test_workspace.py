"""The memory that a thread keeps from one simulation to the next."""

from typing import Any

import numpy as np
from energy_evaluation import ligaments_of

from identknee.mechanics.energy import evaluate
from identknee.mechanics.equilibria import kept_workspace
from identknee.mechanics.memory import N_LISTED, Workspace
from identknee.model.laxity_model import LaxityModel


def _spoil(group: Any) -> None:
    """Not a number in all places for numbers, and 7 in all for counts."""
    for x in group:
        if isinstance(x, tuple):
            _spoil(x)
        elif isinstance(x, np.record):
            for name in x.dtype.names or ():
                x[name] = np.nan if x.dtype[name].base.kind == "f" else 7
        else:
            x[...] = np.nan if x.dtype.kind == "f" else 7


def _list_nothing(model: LaxityModel, work: Workspace) -> None:
    """A list of no points that claims to hold where the first search begins, as of another knee."""
    point = work.solver.trial
    joint, theta = model.joint, model.parameters.center
    point.pose[:] = model.setting(theta).start_pose_of_search
    knee = joint.contact.arrays(), joint.field.arrays(), ligaments_of(model, theta)
    work.evaluation.placed.counts[N_LISTED] = -1
    evaluate(joint.start_flexion, np.zeros(5), *knee, work.evaluation, point)
    work.evaluation.placed.counts[N_LISTED] = 0


def test_a_simulation_reads_nothing_that_the_one_before_left(reference_model: LaxityModel) -> None:
    theta = reference_model.parameters.center
    before = reference_model.predict(theta)
    size = len(reference_model.joint.contact.points), 2 * len(reference_model.knee.ligaments)
    work = kept_workspace(*size)
    _spoil(work)
    _list_nothing(reference_model, work)
    after = reference_model.predict(theta)
    assert kept_workspace(*size) is work
    assert after.poses.tobytes() == before.poses.tobytes()
    assert np.asarray(after.hessians).tobytes() == np.asarray(before.hessians).tobytes()
    assert np.asarray(after.jacobian).tobytes() == np.asarray(before.jacobian).tobytes()
