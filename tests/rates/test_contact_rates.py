"""Contact converges with the points that carry it."""

from dataclasses import replace

import numpy as np
import pytest
from energy_evaluation import contact_energy, depths
from tolerances import ORDER

from identknee.mechanics.contact_points import contact_points
from identknee.mechanics.equilibria import ContactPoints
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array
from identknee.subject.reference import reference_knee

TRIALS = (0, 10, 25, 40, 60)


def _points(edge_mm: float, number: int | None) -> ContactPoints:
    knee = reference_knee(edge_mm=edge_mm, femur_edge_mm=4.0)
    return contact_points([(x.vertices, x.faces) for x in knee.tibia], number)


def _energies(model: LaxityModel, prediction: Prediction, contact: ContactPoints) -> Array:
    """Contact energy at the poses of some trials, whatever the points."""
    joint = replace(model.joint, contact=contact)
    flexion = np.radians(model.protocol.flexion_deg)
    return np.array(
        [
            contact_energy(joint, depths(joint, flexion[trial], prediction.poses[trial]))
            for trial in TRIALS
        ]
    )


@pytest.fixture(scope="module")
def exact(reference_model: LaxityModel, reference_prediction: Prediction) -> Array:
    return _energies(reference_model, reference_prediction, _points(0.3, None))


def _size(found: Array, exact: Array) -> float:
    return float(np.sqrt((((found - exact) / exact) ** 2).mean()))


def test_vertices_converge_at_least_to_second_order(
    reference_model: LaxityModel, reference_prediction: Prediction, exact: Array
) -> None:
    """Contact ends smoothly where it ends, so that equal points do better than their order."""
    edges = (3.2, 1.6, 0.8)
    sizes = [
        _size(_energies(reference_model, reference_prediction, _points(x, None)), exact)
        for x in edges
    ]
    slope = np.polyfit(np.log(edges), np.log(sizes), 1)[0]
    assert slope >= 2.0 - ORDER
    assert sizes[-1] < 2e-3


def test_patches_converge_to_second_order_of_their_width(
    reference_model: LaxityModel, reference_prediction: Prediction, exact: Array
) -> None:
    """To first order of their number: the depth of a patch is that of its centroid."""
    numbers = (100, 300, 900)
    sizes = [
        _size(_energies(reference_model, reference_prediction, _points(0.5, n)), exact)
        for n in numbers
    ]
    slope = -2.0 * np.polyfit(np.log(numbers), np.log(sizes), 1)[0]
    assert slope == pytest.approx(2.0, abs=2 * ORDER)
