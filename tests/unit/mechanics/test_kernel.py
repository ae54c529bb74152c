"""Finding one minimum, following a branch, and saying how it ended."""

from typing import Any

import numpy as np
import oracle
import pytest
from energy_evaluation import (
    SCALE,
    Evaluator,
    ligaments_of,
    oracle_of,
    point_at,
    random_parameters,
    state_of,
)
from tolerances import RESIDUAL_N, SAME_POSE

from identknee.mechanics import kernel
from identknee.mechanics.equilibria import workspace
from identknee.mechanics.kernel import (
    LAST_STEP,
    find_minimum,
    leaves_branch,
    sensitivities,
    tangent,
)
from identknee.mechanics.memory import (
    CONVERGED,
    FOLD,
    NO_EQUILIBRIUM,
    UNCONSTRAINED,
    Segment,
)
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.declare import Array

# The independent minimiser stops at 1e-6 N or at rounding; a margin of 3 N/mm makes that this far.
INDEPENDENT_MM = 1e-5


def _state(pose: Array, slope: Array) -> Any:
    """An equilibrium that moves along `slope`, without stiffness."""
    state = point_at(pose)
    state.tangent = slope
    return state


SLOPE = np.array([0.02, 0.05, 1.0, -0.5, 0.3])
BEFORE = _state(np.zeros(5), SLOPE)


class Search:
    """The kernel's search at one trial of a model."""

    def __init__(self, model: LaxityModel, theta: Array, trial: int) -> None:
        self.model = model
        self.flexion = float(np.radians(model.protocol.flexion_deg[trial]))
        self.load = np.array(model.paths.loads[model.paths.trial_node[trial]])
        self.ligaments = ligaments_of(model, theta)
        self.arrays = (model.joint.contact.arrays(), model.joint.field.arrays(), self.ligaments)
        self.work = workspace(len(model.joint.contact.points))
        self.state = self.work.path.here

    def minimum(self, start: Array, farthest: float = 1e9) -> tuple[int, float, Array]:
        self.state.pose[:] = start
        outcome, residual = find_minimum(
            self.flexion, self.state, self.load, farthest, LAST_STEP, *self.arrays, self.work
        )
        return outcome, residual, np.array(self.state.pose)

    def residual(self, pose: Array) -> float:
        evaluate = Evaluator(self.model.joint)
        return evaluate(self.flexion, pose, self.ligaments, self.load).residual

    def follow(self, start: Array, load: Array) -> tuple[int, float, Array]:
        """From equilibrium at `start` without load to the load; outcome, share reached, pose."""
        self.load = np.zeros(5)
        _, _, pose = self.minimum(start)
        segment = Segment(
            flexion_before=self.flexion,
            flexion_after=self.flexion,
            load_before=np.zeros(5),
            load_after=load,
        )
        outcome, reached, _, _ = kernel.follow(segment, pose, False, *self.arrays, self.work)
        return outcome, reached, np.array(self.state.pose)


@pytest.mark.parametrize("seed", range(15))
def test_a_minimum_is_found_again_from_around_it(
    reference_model: LaxityModel, reference_prediction: Prediction, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    trial = int(rng.integers(63))
    search = Search(reference_model, reference_model.parameters.center, trial)
    there = reference_prediction.poses[trial]
    start = there + rng.normal(0.0, 1.0, 5) / SCALE
    outcome, _, pose = search.minimum(start)
    assert outcome == CONVERGED
    assert search.residual(pose) < RESIDUAL_N
    assert pose * SCALE == pytest.approx(there * SCALE, abs=SAME_POSE)


@pytest.mark.parametrize("seed", [3, 4])
def test_an_independent_minimiser_ends_at_the_same_place(
    reference_model: LaxityModel, reference_prediction: Prediction, seed: int
) -> None:
    """scipy's trust region on the oracle's energy, from a millimetre away."""
    rng = np.random.default_rng(seed)
    trial = int(rng.integers(63))
    theta = random_parameters(reference_model, rng, share=0.1, pct=0.5)
    search = Search(reference_model, theta, trial)
    outcome, _, pose = search.minimum(reference_prediction.poses[trial])
    assert outcome == CONVERGED
    state = state_of(search.flexion, search.load, search.ligaments)
    start = (pose + rng.normal(0.0, 0.5, 5) / SCALE).tolist()
    found, residual = oracle.independent_minimum(oracle_of(reference_model.joint), state, start)
    assert residual < 1e-4
    assert found * SCALE == pytest.approx(pose * SCALE, abs=INDEPENDENT_MM)


@pytest.mark.parametrize("seed", range(8))
def test_sensitivities_are_the_oracles(
    reference_model: LaxityModel, reference_prediction: Prediction, seed: int
) -> None:
    rng = np.random.default_rng(100 + seed)
    trial = int(rng.integers(63))
    theta = random_parameters(reference_model, rng, share=0.1, pct=0.5)
    search = Search(reference_model, theta, trial)
    outcome, _, pose = search.minimum(reference_prediction.poses[trial])
    assert outcome == CONVERGED
    # The Hessian is that of the last pose evaluated, one Newton step before the one returned.
    evaluation = Evaluator(reference_model.joint)(search.flexion, pose, search.ligaments)
    slopes, columns = np.zeros((5, 8)), np.zeros((5, 8))
    sensitivities(
        search.flexion,
        pose,
        evaluation.hessian,
        search.arrays[0],
        search.ligaments,
        search.work,
        columns,
        slopes,
        np.zeros(39),
    )
    state = state_of(search.flexion, search.load, search.ligaments)
    expected = oracle.sensitivities(oracle_of(reference_model.joint), state, pose.tolist())
    scaled = SCALE[:, None]
    for block in (slice(0, 4), slice(4, 8)):
        error = np.abs((slopes - expected)[:, block] * scaled).max()
        assert error < 1e-9 * np.abs(expected[:, block] * scaled).max()


def test_a_search_that_goes_too_far_has_no_answer(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    search = Search(reference_model, reference_model.parameters.center, 40)
    start = reference_prediction.poses[40] + [0.0, 0.0, 3.0, 0.0, 0.0]
    assert search.minimum(start, farthest=1.0)[0] == NO_EQUILIBRIUM
    assert search.minimum(start, farthest=30.0)[0] == CONVERGED


def test_without_ligaments_nothing_holds_the_tibia(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    theta = reference_model.parameters.center * np.r_[np.zeros(4), np.ones(4)]
    search = Search(reference_model, theta, 5)
    outcome, _, pose = search.minimum(reference_prediction.poses[5])
    assert outcome == UNCONSTRAINED
    assert np.isfinite(pose).all()


def test_a_pull_that_nothing_resists_has_no_equilibrium(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    theta = reference_model.parameters.center * np.r_[np.zeros(4), np.ones(4)]
    search = Search(reference_model, theta, 5)
    search.load = np.array([0.0, 0.0, 0.0, -50.0, 0.0])
    outcome, _, pose = search.minimum(reference_prediction.poses[5])
    assert outcome == NO_EQUILIBRIUM
    assert np.isfinite(pose).all()


def test_a_branch_is_followed_to_the_full_load(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    """One coarse step of 10 N m, which the rule must halve, ends where small steps end."""
    trial = reference_model.protocol.trials.index("flexion30_internal10Nm")
    unloaded = reference_model.protocol.trials.index("flexion30_unloaded")
    search = Search(reference_model, reference_model.parameters.center, trial)
    load = np.array(search.load)
    outcome, reached, pose = search.follow(reference_prediction.poses[unloaded], load)
    assert (outcome, reached) == (CONVERGED, 1.0)
    there = reference_prediction.poses[trial]
    assert pose * SCALE == pytest.approx(there * SCALE, abs=SAME_POSE)


def test_where_a_branch_ends_the_last_stable_pose_is_kept(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    """A pull of 40 kN, beyond what the ligaments of this knee can hold within any short way."""
    unloaded = reference_model.protocol.trials.index("flexion0_unloaded")
    slack = reference_model.parameters.center * np.r_[np.full(4, 0.02), np.ones(4)]
    search = Search(reference_model, slack, unloaded)
    load = np.array([0.0, 9e5, 0.0, 0.0, 0.0])
    outcome, reached, pose = search.follow(reference_prediction.poses[unloaded], load)
    assert outcome in (FOLD, UNCONSTRAINED)
    assert 0.0 <= reached < 1.0
    search.load = reached * load
    assert search.residual(pose) < RESIDUAL_N


def test_tangents_are_slopes_of_the_branch(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    """How the equilibrium moves with load and flexion, against equilibria solved again."""
    search = Search(reference_model, reference_model.parameters.center, 40)
    _, _, pose = search.minimum(reference_prediction.poses[40])
    load_change, flexion_change = np.array([500.0, -200.0, 1.0, 2.0, -1.0]), 0.01
    tangent(search.state, load_change, flexion_change, np.zeros((5, 5)), np.zeros(5))
    step = np.array(search.state.tangent)
    share, ends = 1e-4, []
    load, flexion = np.array(search.load), search.flexion
    for sign in (1.0, -1.0):
        search.load = load + sign * share * load_change
        search.flexion = flexion + sign * share * flexion_change
        ends.append(search.minimum(pose)[2])
    expected = (ends[0] - ends[1]) / (2 * share) * SCALE
    assert step * SCALE == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())


def test_a_tangent_where_there_is_none_is_zero() -> None:
    state = _state(np.zeros(5), np.ones(5))
    tangent(state, np.ones(5), 0.0, np.zeros((5, 5)), np.zeros(5))
    assert not state.tangent.any()


@pytest.mark.parametrize("bend", [0.0, 0.05])
def test_a_step_along_its_tangents_is_on_the_branch(bend: float) -> None:
    after = _state(SLOPE * (1.0 + bend), SLOPE * (1.0 + 2 * bend))
    assert not leaves_branch(BEFORE, after, 1.0, 1.0)


def test_a_jump_is_off_the_branch() -> None:
    jump = np.array([0.0, 0.2, 0.0, 0.0, 0.0])
    assert leaves_branch(BEFORE, _state(SLOPE + jump, SLOPE), 1.0, 1.0)
    # However small the step, the jump stays.
    assert leaves_branch(BEFORE, _state(0.001 * SLOPE + jump, SLOPE), 0.001, 1.0)


def test_a_guess_must_agree_better_than_a_step_of_the_search() -> None:
    beside = _state(SLOPE + np.array([0.0, 0.01, 0.0, 0.0, 0.0]), SLOPE)
    assert not leaves_branch(BEFORE, beside, 1.0, 1.0)
    assert leaves_branch(BEFORE, beside, 1.0, kernel.GUESS_TOLERANCE)


def test_children_of_a_lost_state_are_lost_with_it(reference_model: LaxityModel) -> None:
    """Trials beyond a fold have its outcome, and none is NaN."""
    theta = reference_model.parameters.center * np.r_[np.zeros(4), np.ones(4)]
    found = reference_model.predict(theta)
    assert set(found.codes.tolist()) <= {UNCONSTRAINED, NO_EQUILIBRIUM}
    assert np.isfinite(found.poses).all()
    assert found.hessians is not None
    assert np.isfinite(found.hessians).all()
    assert np.isnan(found.coordinates).all()
