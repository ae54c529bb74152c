"""The memory that a thread keeps from one simulation to the next."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from identknee.mechanics.workspace import kept_workspace
from identknee.model.laxity_model import LaxityModel


def _arrays(group: Any) -> Iterator[np.ndarray]:
    for x in group:
        yield from _arrays(x) if isinstance(x, tuple) else (x,)


def test_a_simulation_reads_nothing_that_the_one_before_left(reference_model: LaxityModel) -> None:
    theta = reference_model.parameters.center
    before = reference_model.predict(theta)
    size = len(reference_model.joint.contact.points), 2 * len(reference_model.knee.ligaments)
    work = kept_workspace(*size)
    for array in _arrays(work.arrays):
        array[...] = np.nan if array.dtype == float else 7
    after = reference_model.predict(theta)
    assert kept_workspace(*size) is work
    assert after.poses.tobytes() == before.poses.tobytes()
    assert np.asarray(after.hessians).tobytes() == np.asarray(before.hessians).tobytes()
    assert np.asarray(after.jacobian).tobytes() == np.asarray(before.jacobian).tobytes()
