"""The contact expanded around one pose says what it is at poses near by, the better the nearer."""

import numpy as np
import pytest
from energy_evaluation import NO_LOAD, SCALE, Evaluator, ligaments_of, point_at

from identknee.mechanics.energy import evaluate_near
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

# mm; far enough that rounding does not show, near enough that few points begin to touch.
DISTANCES = np.array([0.016, 0.008, 0.004])


def _errors(model: LaxityModel, trial: int, direction: Array) -> tuple[Array, Array]:
    """Relative errors of gradient and Hessian of the expansion at each distance."""
    prediction = model.predict(model.parameters.center, derivatives=False)
    flexion = float(np.radians(model.protocol.flexion_deg[trial]))
    pose = np.array(prediction.poses[trial])
    ligaments = ligaments_of(model, model.parameters.center)
    evaluate = Evaluator(model.joint)
    gradients, hessians = [], []
    for distance in DISTANCES:
        there = pose + distance * direction / SCALE
        exact = evaluate(flexion, there, ligaments)
        evaluate(flexion, pose, ligaments)
        near = point_at(there)
        law, grid = evaluate._contact.law, evaluate._field.grid
        placed, expansion = evaluate.work.placed, evaluate.work.expansion
        evaluate_near(flexion, NO_LOAD, law, grid, ligaments, placed, expansion, near)
        gradients.append(np.abs((near.gradient - exact.gradient) / SCALE).max())
        hessians.append(np.abs((near.hessian - exact.hessian) / SCALE / SCALE[:, None]).max())
    return np.array(gradients), np.array(hessians)


@pytest.mark.parametrize("seed", range(6))
def test_forces_are_right_to_second_order_and_stiffness_to_first(
    reference_model: LaxityModel, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=5)
    direction /= np.linalg.norm(direction)
    gradients, hessians = _errors(reference_model, int(rng.integers(63)), direction)
    # Half as far, a quarter of the error of the force, half that of the stiffness.
    assert gradients[2] < 0.08 * gradients[0]
    assert hessians[2] < 0.32 * hessians[0]
    # N and N/mm, beside forces of some 100 N and stiffnesses of some 1,000 N/mm.
    assert gradients[2] < 1e-3
    assert hessians[2] < 0.5


def test_at_the_pose_itself_nothing_is_left_out(reference_model: LaxityModel) -> None:
    gradients, hessians = [], []
    evaluate = Evaluator(reference_model.joint)
    ligaments = ligaments_of(reference_model, reference_model.parameters.center)
    prediction = reference_model.predict(reference_model.parameters.center, derivatives=False)
    for trial in range(0, 63, 9):
        flexion = float(np.radians(reference_model.protocol.flexion_deg[trial]))
        pose = np.array(prediction.poses[trial])
        exact = evaluate(flexion, pose, ligaments)
        near = point_at(pose)
        law, grid = evaluate._contact.law, evaluate._field.grid
        placed, expansion = evaluate.work.placed, evaluate.work.expansion
        evaluate_near(flexion, NO_LOAD, law, grid, ligaments, placed, expansion, near)
        gradients.append(np.abs(near.gradient - exact.gradient).max())
        hessians.append(np.abs(near.hessian - exact.hessian).max())
    assert max(gradients) < 1e-8
    assert max(hessians) < 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_the_pose_does_not_hang_on_where_the_search_began(
    reference_model: LaxityModel, seed: int
) -> None:
    """Warm from parameters near by and cold along the load path, to a millionth of a micrometre."""
    rng = np.random.default_rng(seed)
    center = reference_model.parameters.center
    theta = center * (1.0 + 0.01 * rng.normal(size=center.size))
    cold = reference_model.predict(theta)
    for size in (1e-7, 1e-5, 1e-3):
        beside = theta * (1.0 + size * rng.normal(size=center.size))
        near = reference_model.predict(beside, derivatives=False)
        warm = reference_model.predict(theta, near=near)
        assert cold.jacobian is not None
        assert warm.jacobian is not None
        assert np.abs((warm.poses - cold.poses) * SCALE).max() < 1e-9
        scale = np.abs(cold.jacobian).max(axis=(0, 1))
        assert (np.abs(warm.jacobian - cold.jacobian).max(axis=(0, 1)) < 1e-5 * scale).all()
