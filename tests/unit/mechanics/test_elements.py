"""Culling hides no contact, and the centres of contact are those of the forces."""

import numpy as np
import pytest
from energy_evaluation import (
    Evaluator,
    contact_energy,
    depths,
    femoral_places,
    field_values,
    ligaments_of,
)
from tolerances import DERIVATIVE

from identknee.mechanics.contact_elements import contact_centres, write_contact_forces
from identknee.mechanics.distance_field import PRESSURE_MODULUS
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array

# Depths smaller than this are contact or not as rounding has it [mm].
ROUNDING_MM = 1e-12
UP = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
JITTER = np.array([1 / 40, 1 / 40, 1.0, 1.0, 1.0])


def _compare(model: LaxityModel, evaluate: Evaluator, flexion: float, pose: Array) -> int:
    """Kernel and brute force find the same contact; how many points there are."""
    ligaments = ligaments_of(model, model.parameters.vector({}) * np.r_[np.zeros(4), np.ones(4)])
    found = evaluate(flexion, pose, ligaments)
    depth = depths(model.joint, flexion, pose)
    surely = set(np.flatnonzero(depth < -ROUNDING_MM).tolist())
    perhaps = set(np.flatnonzero(depth < ROUNDING_MM).tolist())
    assert surely <= found.touching <= perhaps
    expected = contact_energy(model.joint, depth)
    assert found.energy == pytest.approx(expected, rel=DERIVATIVE, abs=1e-12)
    return len(surely)


@pytest.mark.parametrize("size", [0.02, 0.3, 2.0, 20.0])
def test_contact_on_a_random_walk_is_that_of_brute_force(
    reference_model: LaxityModel, reference_prediction: Prediction, size: float
) -> None:
    """Steps far below a cell's width, near it and beyond: the list is kept, or made again."""
    rng = np.random.default_rng(int(100 * size))
    evaluate = Evaluator(reference_model.joint)
    n = 150
    most = 0
    pose, flexion = np.array(reference_prediction.poses[40]), np.pi / 6
    for _ in range(n):
        most = max(most, _compare(reference_model, evaluate, flexion, pose))
        pose = pose + size * rng.normal(size=5) * JITTER / np.sqrt(5)
        flexion += 0.2 * size / 40 * rng.normal()
        # Back towards the joint, so that the walk stays in contact.
        pose = pose + 0.3 * (reference_prediction.poses[40] - pose)
    assert most > 20
    assert 1 <= evaluate.n_listings <= n
    if size <= 0.02:
        assert evaluate.n_listings < n // 4
    if size >= 2.0:
        assert evaluate.n_listings > n // 2


@pytest.mark.parametrize("seed", range(3))
def test_jumps_across_the_joint_and_off_the_grid(
    reference_model: LaxityModel, reference_prediction: Prediction, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    evaluate = Evaluator(reference_model.joint)
    counts = []
    for _ in range(60):
        trial = int(rng.integers(63))
        flexion = float(np.radians(reference_model.protocol.flexion_deg[trial]))
        pose = np.array(reference_prediction.poses[trial])
        if rng.random() < 0.5:
            pose += rng.normal(size=5) * [0.3, 0.6, 30.0, 30.0, 30.0]
        counts.append(_compare(reference_model, evaluate, flexion, pose))
    assert min(counts) == 0
    assert max(counts) > 50


@pytest.mark.parametrize("trial", [5, 0, 10])
def test_a_slow_approach_keeps_one_list_until_it_must_not(
    reference_model: LaxityModel, reference_prediction: Prediction, trial: int
) -> None:
    """The tibia comes up from 3 mm below, a hundredth of a cell a step."""
    evaluate = Evaluator(reference_model.joint)
    base = np.array(reference_prediction.poses[trial])
    for height in np.arange(-3.0, 0.6, 0.0075):
        _compare(reference_model, evaluate, 0.0, base + height * UP)
    # A list lasts for one cell's width of motion.
    assert 4 <= evaluate.n_listings <= 8


def test_centres_are_the_means_of_the_forces(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    joint, trial = reference_model.joint, 60
    pose, flexion = reference_prediction.poses[trial], np.pi / 3
    evaluate = Evaluator(joint)
    evaluate(flexion, pose, ligaments_of(reference_model, reference_model.parameters.center))
    centres = np.zeros((2, 7))
    write_contact_forces(joint.contact.arrays().law, evaluate.work)
    contact_centres(joint.contact.arrays(), evaluate.work, centres)
    assert centres == pytest.approx(reference_prediction.centres[trial], rel=1e-6)
    places = femoral_places(flexion, pose, joint.contact.points)
    depth = np.minimum(depths(joint, flexion, pose), 0.0)
    slopes = [
        (field_values(joint.field, places + x) - field_values(joint.field, places - x)) / 2e-5
        for x in 1e-5 * np.eye(3)
    ]
    size = -PRESSURE_MODULUS * joint.contact.areas * depth * np.linalg.norm(slopes, axis=0)
    for c in range(2):
        mine = size * (joint.contact.compartment == c)
        assert centres[c, 0] == pytest.approx(mine.sum(), rel=1e-7)
        tibial = mine @ joint.contact.points / mine.sum()
        assert centres[c, 1:4] == pytest.approx(tibial, abs=1e-6)
        assert centres[c, 4:7] == pytest.approx(mine @ places / mine.sum(), abs=1e-6)


def test_a_compartment_without_contact_has_no_force(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    joint = reference_model.joint
    evaluate = Evaluator(joint)
    apart = np.array(reference_prediction.poses[5]) - [0.0, 0.0, 0.0, 20.0, 0.0]
    evaluate(0.0, apart, ligaments_of(reference_model, reference_model.parameters.center))
    centres = np.ones((2, 7))
    write_contact_forces(joint.contact.arrays().law, evaluate.work)
    contact_centres(joint.contact.arrays(), evaluate.work, centres)
    assert not centres.any()
