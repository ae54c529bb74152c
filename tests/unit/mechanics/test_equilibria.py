"""Equilibria of many trials: what is left of the gradient, slopes, margins."""

from typing import Any

import numpy as np
import pytest
from energy_evaluation import SCALE, Evaluator, random_parameters
from tolerances import CLOSED_FORM, DIFFERENCE, RESIDUAL_N

from identknee.mechanics.distance_field import PRESSURE_MODULUS
from identknee.mechanics.equilibria import (
    TRANSITION_STRAIN,
    ContactPoints,
    LineLigaments,
    solve,
    stability_margins,
)
from identknee.mechanics.memory import CONVERGED, Equilibria
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array


def _solve(model: LaxityModel, ligaments: Any) -> Equilibria:
    return solve(model.paths, model.joint.start, model.joint.contact, model.joint.field, ligaments)


@pytest.mark.parametrize("seed", range(30))
def test_what_is_left_of_the_gradient_is_small_at_every_node(
    reference_model: LaxityModel, seed: int
) -> None:
    """Measured afresh at the poses returned, over random parameters, most of them wide."""
    rng = np.random.default_rng(seed)
    model, m = reference_model, 4
    theta = (
        np.r_[rng.uniform(0.0, 40.0, m), rng.uniform(-15.0, 15.0, m)]
        if seed % 3
        else random_parameters(model, rng, share=0.5, pct=3.0)
    )
    ligaments = model.joint.lines.arrays(theta[:m] * 1000.0, theta[m:] / 100.0)
    found = _solve(model, ligaments)
    evaluate = Evaluator(model.joint)
    for node in np.flatnonzero(found.codes == CONVERGED):
        evaluation = evaluate(
            model.paths.flexion[node], found.poses[node], ligaments, model.paths.loads[node]
        )
        assert evaluation.residual <= RESIDUAL_N
        # The Hessian returned is that of a pose one last tiny Newton step before.
        largest = np.abs(evaluation.hessian / SCALE / SCALE[:, None]).max()
        difference = (evaluation.hessian - found.hessians[node]) / SCALE / SCALE[:, None]
        assert np.abs(difference).max() <= 1e-4 * largest


def _slopes_and_kinks(
    model: LaxityModel, stiffness: Array, strain: Array, parameter: int
) -> tuple[Array, Array]:
    """Central differences of all poses by one parameter; nodes whose contact stays the same."""
    m = len(stiffness)
    step = 2e-4 * 1000.0 if parameter < m else 2e-4 / 100.0
    ends, touching = [], []
    for sign in (1.0, -1.0):
        move = np.zeros(2 * m)
        move[parameter] = sign * step
        ligaments = model.joint.lines.arrays(stiffness + move[:m], strain + move[m:])
        found = _solve(model, ligaments)
        evaluate = Evaluator(model.joint)
        ends.append(found.poses)
        touching.append(
            [
                evaluate(flexion, pose, ligaments).touching
                for flexion, pose in zip(model.paths.flexion, found.poses, strict=True)
            ]
        )
    same = np.array([a == b for a, b in zip(*touching, strict=True)])
    return (ends[0] - ends[1]) / (2 * step), same


@pytest.mark.parametrize("parameter", range(8))
@pytest.mark.parametrize("seed", [1, 2])
def test_sensitivities_are_slopes_of_equilibria_solved_again(
    reference_model: LaxityModel, seed: int, parameter: int
) -> None:
    """Where a point starts or ends its contact within the step, the slope has a kink: left out."""
    model, m = reference_model, 4
    theta = random_parameters(model, np.random.default_rng(seed), share=0.15, pct=1.0)
    stiffness, strain = theta[:m] * 1000.0, theta[m:] / 100.0
    found = _solve(model, model.joint.lines.arrays(stiffness, strain))
    assert (found.codes == CONVERGED).all()
    slopes, same = _slopes_and_kinks(model, stiffness, strain, parameter)
    assert same.mean() > 0.8
    exact = found.sensitivities[:, :, parameter]
    block = found.sensitivities[:, :, :m] if parameter < m else found.sensitivities[:, :, m:]
    largest = np.abs(block * SCALE[:, None]).max()
    error = np.abs((slopes - exact) * SCALE).max(axis=1) / largest
    assert error[same].max() <= DIFFERENCE


def test_margins_are_eigenvalues_with_scaled_rotations() -> None:
    diagonal = np.array([[1600.0 * 3.0, 1600.0 * 4.0, 5.0, 6.0, 7.0], [1600.0, 1600, 0.5, 1, 1]])
    hessians = np.stack([np.diag(x) for x in diagonal])
    assert stability_margins(hessians) == pytest.approx([3.0, 0.5], rel=CLOSED_FORM)


def test_points_and_lines_go_to_the_kernel_as_it_wants_them() -> None:
    contact = ContactPoints(
        points=np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]]),
        areas=np.array([2.0, 0.5]),
        compartment=np.array([0, 1]),
    )
    points, radius, stiffness, compartment, law, menisci = contact.arrays()
    assert points.shape == (3, 2)
    assert points.flags.c_contiguous
    assert radius >= 5.0
    assert stiffness.tolist() == [2.0 * PRESSURE_MODULUS, 0.5 * PRESSURE_MODULUS]
    assert compartment.tolist() == [0, 1]
    assert contact.n_compartments == 2
    lines = LineLigaments(
        femoral=np.zeros((1, 3)), tibial=np.ones((1, 3)), reference_length=np.array([3.0**0.5])
    )
    (line,) = lines.arrays(np.array([8000.0]), np.array([0.02])).tolist()
    assert line[2:8] == (8000.0, 0.02, 3.0**0.5, TRANSITION_STRAIN, 0.0, 0.5)
    assert line[8:10] == (0.0, 0.0)
    assert [x.tolist() for x in line[:2]] == [[0.0] * 3, [1.0] * 3]
    assert law == (1.0, 0.0)
    assert menisci.points.shape == (3, 0)


def test_points_of_the_wrong_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"areas.* 2"):
        ContactPoints(points=np.zeros((2, 3)), areas=np.zeros(3), compartment=np.zeros(2, np.int64))


def test_without_derivatives_the_poses_are_the_same(reference_model: LaxityModel) -> None:
    model = reference_model
    ligaments = model.joint.lines.arrays(
        model.parameters.center[:4] * 1000.0, model.parameters.center[4:] / 100.0
    )
    arguments = (model.paths, model.joint.start, model.joint.contact, model.joint.field, ligaments)
    with_them, without = solve(*arguments), solve(*arguments, derivatives=False)
    np.testing.assert_array_equal(with_them.poses, without.poses)
    assert not without.sensitivities.any()
    assert (without.solves >= 1).all()
    # Of a smooth branch most steps are one search.
    assert without.solves.mean() < 1.5


def test_guesses_change_nothing_but_the_way(reference_model: LaxityModel) -> None:
    model = reference_model
    ligaments = model.joint.lines.arrays(
        model.parameters.center[:4] * 1000.0, model.parameters.center[4:] / 100.0
    )
    arguments = (model.paths, model.joint.start, model.joint.contact, model.joint.field, ligaments)
    cold = solve(*arguments)
    rng = np.random.default_rng(0)
    for size in (1e-3, 1.0, 50.0):
        guesses = cold.poses + size * rng.normal(size=cold.poses.shape) / SCALE
        warm = solve(*arguments, guesses=guesses)
        assert warm.poses * SCALE == pytest.approx(cold.poses * SCALE, abs=1e-9)
        assert (warm.codes == CONVERGED).all()
