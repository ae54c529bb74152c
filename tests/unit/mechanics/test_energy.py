"""The energy and its derivatives against the oracle, at random poses near equilibria."""

from typing import Any

import numpy as np
import oracle
import pytest
from energy_evaluation import (
    SCALE,
    Evaluator,
    contact_energy,
    depths,
    ligaments_of,
    oracle_of,
    random_parameters,
    state_of,
)
from oracle import OracleKnee
from slow_cases import some_slow
from tolerances import CLOSED_FORM, DERIVATIVE

from identknee.mechanics.energy import motion_axes, parameter_columns, place_tibia
from identknee.mechanics.memory import PLACED, record
from identknee.mechanics.pose import rotation_matrix
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array

Case = tuple[float, Array, Array, Any]


@pytest.fixture(scope="module")
def slow_knee(reference_model: LaxityModel) -> OracleKnee:
    return oracle_of(reference_model.joint)


def _case(model: LaxityModel, prediction: Prediction, seed: int) -> Case:
    """Flexion, a pose near an equilibrium, a load and random ligaments."""
    rng = np.random.default_rng(seed)
    trial = int(rng.integers(model.protocol.n))
    pose = prediction.poses[trial] + rng.normal(0.0, 0.4, 5) / [20.0, 20.0, 1.0, 1.0, 1.0]
    flexion = float(np.radians(model.protocol.flexion_deg[trial])) + rng.normal(0.0, 0.05)
    load = rng.normal(0.0, 60.0, 5) * SCALE
    return flexion, pose, load, ligaments_of(model, random_parameters(model, rng))


def _relative(found: Array, expected: Array) -> float:
    """Largest difference over the largest entry."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("seed", some_slow(range(12), range(4, 12)))
def test_energy_gradient_hessian_and_flexion_slope_are_the_oracles(
    reference_model: LaxityModel,
    reference_prediction: Prediction,
    slow_knee: OracleKnee,
    seed: int,
) -> None:
    flexion, pose, load, ligaments = _case(reference_model, reference_prediction, seed)
    found = Evaluator(reference_model.joint)(flexion, pose, ligaments, load)
    assert len(found.touching) > 5
    state, place = state_of(flexion, load, ligaments), pose.tolist()
    assert found.energy == pytest.approx(oracle.energy(slow_knee, state, place), rel=CLOSED_FORM)
    gradient = np.array(oracle.gradient_by_complex_step(slow_knee, state, place))
    assert _relative(found.gradient / SCALE, gradient / SCALE) < DERIVATIVE
    both = SCALE[:, None] * SCALE
    hessian = np.array(oracle.hessian(slow_knee, state, place))
    assert _relative(found.hessian / both, hessian / both) < DERIVATIVE
    flexed = state_of(flexion + 1j * oracle.STEP, load, ligaments)
    slope = np.array([complex(x).imag for x in oracle.gradient(slow_knee, flexed, place)])
    assert _relative(found.flexion_slope / SCALE, slope / oracle.STEP / SCALE) < DERIVATIVE


@pytest.mark.parametrize("seed", range(20, 24))
def test_slopes_by_the_parameters_are_the_oracles(
    reference_model: LaxityModel,
    reference_prediction: Prediction,
    slow_knee: OracleKnee,
    seed: int,
) -> None:
    flexion, pose, load, ligaments = _case(reference_model, reference_prediction, seed)
    placed, columns = record(PLACED), np.zeros((5, 8))
    place_tibia(flexion, pose, placed.rotation, placed.translation)
    motion_axes(flexion, placed.rotation, placed.translation, placed.axes)
    parameter_columns(placed, ligaments, columns)
    state = state_of(flexion, load, ligaments)
    expected = np.array(oracle.parameter_slopes(slow_knee, state, pose.tolist()))
    for block in (slice(0, 4), slice(4, 8)):
        assert _relative(columns[:, block], expected[:, block]) < DERIVATIVE


@pytest.mark.parametrize("seed", range(4))
def test_the_tibia_is_placed_as_the_pose_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flexion, pose = rng.uniform(0.0, 2.0), rng.normal(size=5)
    R, t = np.zeros(9), np.zeros(3)
    place_tibia(flexion, pose, R, t)
    expected = rotation_matrix(flexion, pose[0], pose[1])
    assert R.reshape(3, 3) == pytest.approx(expected, abs=CLOSED_FORM)
    origin = rotation_matrix(flexion, 0.0, 0.0) @ pose[2:]
    assert t == pytest.approx(origin, abs=CLOSED_FORM)


@pytest.mark.parametrize("seed", range(30, 40))
def test_without_ligaments_and_load_it_is_the_springs_at_the_points(
    reference_model: LaxityModel, reference_prediction: Prediction, seed: int
) -> None:
    flexion, pose, _, ligaments = _case(reference_model, reference_prediction, seed)
    ligaments.stiffness = 0.0
    found = Evaluator(reference_model.joint)(flexion, pose, ligaments)
    expected = contact_energy(reference_model.joint, depths(reference_model.joint, flexion, pose))
    assert found.energy == pytest.approx(expected, rel=DERIVATIVE)


def test_a_load_does_work_on_the_coordinates(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    flexion, pose, load, ligaments = _case(reference_model, reference_prediction, seed=50)
    evaluate = Evaluator(reference_model.joint)
    free, loaded = evaluate(flexion, pose, ligaments), evaluate(flexion, pose, ligaments, load)
    assert free.energy - loaded.energy == pytest.approx(load @ pose, rel=1e-9)
    assert free.gradient - loaded.gradient == pytest.approx(load, rel=1e-9)
    np.testing.assert_array_equal(free.hessian, loaded.hessian)
    np.testing.assert_array_equal(free.hessian, free.hessian.T)
