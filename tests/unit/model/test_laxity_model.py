"""Predictions: exact slopes, one answer whatever came before, an outcome for every trial."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import oracle
import pytest
from energy_evaluation import SCALE, Evaluator, ligaments_of, random_parameters
from narrow_knee import narrow_knee
from tolerances import DIFFERENCE, RESIDUAL_N, SAME_MARGIN, SAME_POSE

from identknee.laxity.protocol import Protocol, load_protocol
from identknee.mechanics.pose import coordinates_from_pose, rotation_matrix
from identknee.model import laxity_model as joint
from identknee.model.effects.loads import compression
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import OUTCOMES, Prediction
from identknee.runs.declare import Array
from identknee.runs.record import Outcome
from identknee.subject.reference import reference_knee

N_WIDE = 100
# Contact is that of the pose before the last step, which is shorter than 3e-7 mm.
CONTACT_N = 1e-3
TRIAL_OUTCOMES = {
    Outcome.CONVERGED,
    Outcome.FOLD,
    Outcome.NO_EQUILIBRIUM,
    Outcome.UNCONSTRAINED,
}


def _wide(model: LaxityModel, n: int, seed: int) -> Array:
    """Parameter vectors from the whole box."""
    return np.random.default_rng(seed).uniform(
        model.parameters.lower, model.parameters.upper, (n, model.parameters.n)
    )


# --- slopes -------------------------------------------------------------------------------------


def _touching(model: LaxityModel, prediction: Prediction) -> list[frozenset[int]]:
    evaluate, ligaments = Evaluator(model.joint), ligaments_of(model, prediction.theta)
    flexion = np.radians(model.protocol.flexion_deg)
    return [
        evaluate(a, q, ligaments).touching for a, q in zip(flexion, prediction.poses, strict=True)
    ]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["reference_model", "small_model"])
def test_the_jacobian_is_the_slope_of_the_coordinates(
    name: str, seed: int, request: pytest.FixtureRequest
) -> None:
    """In the units of the table and of theta; where contact changes within the step is left out."""
    model: LaxityModel = request.getfixturevalue(name)
    theta = random_parameters(model, np.random.default_rng(seed), share=0.1, pct=0.5)
    found = model.predict(theta)
    assert found.jacobian is not None
    assert found.all_converged
    m, left_out = model.parameters.n // 2, 0
    for parameter in range(model.parameters.n):
        move = np.zeros(model.parameters.n)
        move[parameter] = 1e-4
        ends = [model.predict(theta + s * move, derivatives=False) for s in (1.0, -1.0)]
        same = np.array([a == b for a, b in zip(*(_touching(model, x) for x in ends), strict=True)])
        left_out += int((~same).sum())
        slopes = (ends[0].coordinates - ends[1].coordinates) / 2e-4
        block = found.jacobian[:, :, :m] if parameter < m else found.jacobian[:, :, m:]
        error = np.abs(slopes - found.jacobian[:, :, parameter])[same]
        assert error.max() <= DIFFERENCE * np.abs(block).max()
    assert left_out <= 0.05 * model.protocol.n * model.parameters.n


def test_without_derivatives_there_is_no_jacobian(small_model: LaxityModel) -> None:
    with_it = small_model.predict(small_model.parameters.center)
    without = small_model.predict(small_model.parameters.center, derivatives=False)
    assert without.jacobian is None
    np.testing.assert_array_equal(with_it.coordinates, without.coordinates)


# --- one answer ---------------------------------------------------------------------------------


def _same(first: Prediction, second: Prediction) -> None:
    """Alike to the promise wherever the margin is enough, in outcome and in pose."""
    firm = (first.margins >= SAME_MARGIN) & (second.margins >= SAME_MARGIN)
    np.testing.assert_array_equal(first.codes[firm], second.codes[firm])
    both = firm & first.is_converged & second.is_converged
    difference = np.abs((first.poses - second.poses) * SCALE)[both]
    assert difference.size == 0 or difference.max() <= SAME_POSE


@pytest.mark.parametrize("seed", range(20))
def test_a_warm_start_gives_the_cold_answer(reference_model: LaxityModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = {"share": rng.choice([0.1, 0.5, 0.9]), "pct": rng.choice([0.5, 3.0, 8.0])}
    near = reference_model.predict(random_parameters(reference_model, rng, **box))
    theta = random_parameters(reference_model, rng, **box)
    if seed % 2:
        theta = near.theta + 0.05 * (theta - near.theta)
    cold = reference_model.predict(theta)
    _same(cold, reference_model.predict(theta, near=near))
    # From where it already is, too.
    _same(cold, reference_model.predict(theta, near=cold))


@pytest.mark.parametrize("seed", range(4))
def test_a_warm_start_gives_the_cold_answer_on_the_real_knee(
    stable_model: LaxityModel, seed: int
) -> None:
    test_a_warm_start_gives_the_cold_answer(stable_model, seed)


def test_a_guess_on_another_branch_is_not_taken(reference_model: LaxityModel) -> None:
    """Equilibria that a single step lands on, offered as guesses where the branch is another."""
    model, nodes = reference_model, reference_model.paths.trial_node
    single, offered = replace(model, continuation="single-step"), 0
    for theta in _wide(model, 120, seed=16):
        cold = model.predict(theta, derivatives=False)
        other = single.predict(theta, derivatives=False)
        apart = np.abs((cold.poses - other.poses) * SCALE).max(axis=1) > 1.0
        apart &= cold.is_converged & other.is_converged
        apart &= (cold.margins >= SAME_MARGIN) & (other.margins >= SAME_MARGIN)
        offered += int(apart.sum())
        guesses = np.array(cold.node_poses)
        guesses[nodes[apart]] = other.poses[apart]
        _same(cold, model.predict(theta, near=replace(cold, node_poses=guesses)))
    assert offered > 5


def test_the_order_of_evaluation_does_not_matter(reference_model: LaxityModel) -> None:
    rng = np.random.default_rng(11)
    thetas = [random_parameters(reference_model, rng, share=0.5, pct=3.0) for _ in range(3)]
    cold = [reference_model.predict(x) for x in thetas]
    for order in itertools.permutations(range(3)):
        last = None
        for i in order:
            last = reference_model.predict(thetas[i], near=last)
            _same(cold[i], last)
    for i in (2, 0, 1):
        again = reference_model.predict(thetas[i])
        np.testing.assert_array_equal(again.poses, cold[i].poses)
        assert again.outcomes == cold[i].outcomes


def test_a_trial_does_not_depend_on_the_others(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    rng = np.random.default_rng(12)
    theta = reference_model.parameters.center
    for size in (1, 5, 40, 63):
        chosen = rng.permutation(63)[:size]
        some = reference_model.with_protocol(reference_model.protocol.select(chosen))
        found = some.predict(theta)
        difference = (found.poses - reference_prediction.poses[chosen]) * SCALE
        assert np.abs(difference).max() <= SAME_POSE
        assert found.jacobian is not None
        assert reference_prediction.jacobian is not None
        expected = reference_prediction.jacobian[chosen]
        assert found.jacobian == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_a_lost_trial_does_not_lose_the_others(small_model: LaxityModel) -> None:
    far = Protocol(
        name="far",
        trials=("pulled apart",),
        flexion_deg=np.array([0.0]),
        loads=np.array([[0.0, 0.0, 0.0, 900.0, 0.0]]),
    )
    trials = (*small_model.protocol.trials, *far.trials)
    both = Protocol(
        name="both",
        trials=trials,
        flexion_deg=np.r_[small_model.protocol.flexion_deg, far.flexion_deg],
        loads=np.r_[small_model.protocol.loads, far.loads],
    )
    slack = small_model.parameters.center * np.r_[np.full(4, 0.2), np.ones(4)]
    alone, together = small_model.predict(slack), small_model.with_protocol(both).predict(slack)
    assert together.outcomes[:-1] == alone.outcomes
    difference = (together.poses[:-1] - alone.poses) * SCALE
    assert np.abs(difference[alone.is_converged]).max() <= SAME_POSE


# --- outcomes -----------------------------------------------------------------------------------


def test_every_trial_ends_in_an_outcome_and_none_in_nan(reference_model: LaxityModel) -> None:
    counts = dict.fromkeys(TRIAL_OUTCOMES, 0)
    for theta in _wide(reference_model, N_WIDE, seed=13):
        found = reference_model.predict(theta)
        for outcome in found.outcomes:
            counts[outcome] += 1
        ok = found.is_converged
        assert np.isfinite(found.poses).all()
        assert np.isfinite(found.coordinates[ok]).all()
        assert np.isnan(found.coordinates[~ok]).all()
        assert found.jacobian is not None
        assert np.isfinite(found.jacobian[ok]).all()
        assert np.isnan(found.jacobian[~ok]).all()
        assert np.isfinite(found.margins).all()
        assert (found.margins[ok] > 0.0).all()
        assert ((found.reached >= 0.0) & (found.reached <= 1.0)).all()
    assert sum(counts.values()) == 63 * N_WIDE
    # Most of the wide box lets this knee stand; where it does not, the reasons are several.
    assert counts[Outcome.CONVERGED] > 0.5 * 63 * N_WIDE
    assert sum(count > 0 for count in counts.values()) >= 3


def test_converged_trials_of_the_wide_box_are_in_equilibrium(reference_model: LaxityModel) -> None:
    evaluate = Evaluator(reference_model.joint)
    flexion = np.radians(reference_model.protocol.flexion_deg)
    loads = reference_model.paths.loads[reference_model.paths.trial_node]
    for theta in _wide(reference_model, 10, seed=14):
        found, ligaments = reference_model.predict(theta), ligaments_of(reference_model, theta)
        for trial in np.flatnonzero(found.is_converged):
            at = evaluate(flexion[trial], found.poses[trial], ligaments, loads[trial])
            assert at.residual <= RESIDUAL_N


def test_near_the_subjects_own_values_the_reference_converges(reference_model: LaxityModel) -> None:
    rng = np.random.default_rng(15)
    found = [
        reference_model.predict(
            random_parameters(reference_model, rng, share=0.5, pct=3.0), derivatives=False
        ).is_converged.mean()
        for _ in range(50)
    ]
    assert np.mean(found) >= 0.99


def test_contact_forces_are_those_of_the_pose(reference_model: LaxityModel) -> None:
    """Also where that pose was found before others that were searched on the way to it."""
    theta = reference_model.parameters.center
    found = reference_model.predict(theta, derivatives=False)
    evaluate, ligaments = Evaluator(reference_model.joint), ligaments_of(reference_model, theta)
    flexion = np.radians(reference_model.protocol.flexion_deg)
    for angle, pose, centres in zip(flexion, found.poses, found.centres, strict=True):
        evaluate(angle, pose, ligaments)
        forces = np.linalg.norm(evaluate.contact_forces(), axis=1)
        assert centres[:, 0].sum() == pytest.approx(forces.sum(), abs=CONTACT_N)


def test_contact_near_a_rim_is_kept_and_says_so() -> None:
    """Deep flexion takes contact to the back rims."""
    angles = np.arange(90.0, 141.0, 10.0)
    protocol = Protocol(
        name="deep",
        trials=tuple(f"{x:g}" for x in angles),
        flexion_deg=angles,
        loads=np.zeros((len(angles), 5)),
    )
    model = LaxityModel(knee=reference_knee(edge_mm=2.0), protocol=protocol)
    found = model.predict(model.parameters.center)
    assert not found.is_near_rim[0]
    assert found.is_near_rim[1:].any()
    assert np.isfinite(found.coordinates[found.is_near_rim]).all()


def test_a_light_compartment_near_a_rim_loses_no_trial() -> None:
    model = LaxityModel(knee=narrow_knee(0.8), protocol=load_protocol("seed63"))
    found = model.predict(model.parameters.center)
    assert found.all_converged
    light = found.rim_share[found.rim_share > 0.0]
    assert light.size
    assert light.max() < 0.5
    for trial in np.flatnonzero(found.rim_share):
        forces = found.centres[trial, :, 0]
        # The share is that of one compartment, the other one's contact being far from any rim.
        assert found.rim_share[trial] == pytest.approx(forces.min() / forces.sum())


def test_residuals_go_on_smoothly_where_contact_comes_near_a_rim() -> None:
    """No step: along a line on which trials come near a rim, differences follow the Jacobian."""
    model = LaxityModel(knee=narrow_knee(0.8), protocol=load_protocol("seed63"))
    center = model.parameters.center
    direction = np.eye(model.parameters.n)[4]
    found = [model.predict(center + x * direction) for x in np.linspace(-2.0, 2.0, 41)]
    counts = [int((x.rim_share > 0.0).sum()) for x in found]
    assert len(set(counts)) > 1
    for one, two in itertools.pairwise(found):
        assert one.jacobian is not None
        assert two.jacobian is not None
        step = two.theta - one.theta
        mean = 0.5 * (one.jacobian + two.jacobian) @ step
        assert np.abs(two.coordinates - one.coordinates - mean).max() < 0.02


def test_without_ligaments_every_trial_says_so(small_model: LaxityModel) -> None:
    found = small_model.predict(small_model.parameters.center * np.r_[np.zeros(4), np.ones(4)])
    assert not found.is_converged.any()
    assert set(found.outcomes) <= {Outcome.UNCONSTRAINED, Outcome.NO_EQUILIBRIUM}
    assert np.isnan(tensions_of(small_model, found)).all()


def test_codes_name_the_kernels_outcomes() -> None:
    assert set(OUTCOMES) == TRIAL_OUTCOMES
    assert OUTCOMES[0] is Outcome.CONVERGED


# --- what it says -------------------------------------------------------------------------------


def test_coordinates_are_those_of_the_poses(small_model: LaxityModel) -> None:
    found = small_model.predict(small_model.parameters.center)
    np.testing.assert_array_equal(found.coordinates, coordinates_from_pose(found.poses))


def test_tensions_are_those_of_equation_3(
    reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    tensions = tensions_of(reference_model, reference_prediction)
    assert tensions.shape == (63, 4)
    for trial in (0, 25, 62):
        flexion = np.radians(reference_model.protocol.flexion_deg[trial])
        pose = reference_prediction.poses[trial]
        rotation = rotation_matrix(flexion, *pose[:2])
        origin = rotation_matrix(flexion, 0.0, 0.0) @ pose[2:]
        for i, ligament in enumerate(reference_model.knee.ligaments):
            length = np.linalg.norm(rotation @ ligament.tibia + origin - ligament.femur)
            slack_length = ligament.length / (1.0 + ligament.reference_strain_pct / 100.0)
            strain = length / slack_length - 1.0
            expected = oracle.tension(strain, 1000.0 * ligament.stiffness_kN, 0.03)
            assert tensions[trial, i] == pytest.approx(expected, rel=1e-9)


def test_simulated_laxity_is_the_prediction(small_model: LaxityModel) -> None:
    laxity = small_model.simulate(small_model.parameters.center)
    found = small_model.predict(small_model.parameters.center)
    np.testing.assert_array_equal(laxity.coordinates, found.coordinates)
    assert laxity.protocol is small_model.protocol
    assert laxity.sd is None


def test_all_vertices_can_be_asked_for(small_model: LaxityModel) -> None:
    few, whole = replace(small_model, n_points=300), replace(small_model, n_points=None)
    assert len(few.joint.contact.points) < 320
    assert len(whole.joint.contact.points) == 1250
    theta = small_model.parameters.center
    difference = few.predict(theta).coordinates - whole.predict(theta).coordinates
    # Patches of 2 mm2 on dishes of 25 mm radius.
    assert np.abs(difference).max() < 0.2


def test_a_single_step_lands_on_the_same_branch_where_loads_are_small(
    small_model: LaxityModel,
) -> None:
    single = replace(small_model, continuation="single-step")
    assert (single.paths.parent == -1).all()
    theta = small_model.parameters.center
    difference = (single.predict(theta).poses - small_model.predict(theta).poses) * SCALE
    assert np.abs(difference).max() <= SAME_POSE


def test_predictions_can_not_be_written_to(small_model: LaxityModel) -> None:
    theta = np.array(small_model.parameters.center)
    found = small_model.predict(theta)
    theta[0] = 1.0
    assert found.theta[0] == small_model.parameters.center[0]
    with pytest.raises(ValueError, match="read-only"):
        found.coordinates[0] = 0.0


# --- what it refuses ----------------------------------------------------------------------------


def test_a_theta_of_the_wrong_length_is_refused(small_model: LaxityModel) -> None:
    with pytest.raises(ValueError, match=r"theta.*\b8\b.*front\.sti"):
        small_model.predict(np.ones(7))


@pytest.mark.parametrize(("index", "value"), [(1, -0.1), (6, -100.0), (0, np.nan), (7, np.inf)])
def test_values_out_of_range_are_refused_by_name(
    small_model: LaxityModel, index: int, value: float
) -> None:
    theta = np.array(small_model.parameters.center)
    theta[index] = value
    named = re.escape(
        f"{small_model.parameters.names[index]} is {value:g}: stiffness must be finite"
    )
    with pytest.raises(ValueError, match=named):
        small_model.predict(theta)


def test_mesh_contact_has_no_derivatives(small_model: LaxityModel) -> None:
    mesh = replace(small_model, contact="mesh")
    with pytest.raises(ValueError, match=r"mesh.*derivatives"):
        mesh.predict(small_model.parameters.center)


# --- a knee with other ligaments ----------------------------------------------------------------


def test_any_number_of_ligaments_with_any_names(small_model: LaxityModel, tmp_path: Path) -> None:
    """Each ligament twice at half its stiffness is the same knee; one more that is slack too."""
    halves = tuple(
        replace(x, name=f"{x.name} {part}", stiffness_kN=x.stiffness_kN / 2)
        for x in small_model.knee.ligaments
        for part in ("a", "b")
    )
    loose = replace(halves[0], name="loose", reference_strain_pct=-60.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joint, "cache_folder", lambda: tmp_path)
        many = replace(small_model, knee=small_model.knee.with_ligaments((*halves, loose)))
    assert many.parameters.n == 18
    found = many.predict(many.parameters.center)
    expected = small_model.predict(small_model.parameters.center)
    assert np.abs((found.poses - expected.poses) * SCALE).max() <= SAME_POSE
    assert found.jacobian is not None
    assert expected.jacobian is not None
    # The slope by both halves together is that by the whole; the slack one has none.
    pairs = found.jacobian[:, :, :8].reshape(-1, 5, 4, 2).mean(axis=3)
    assert pairs == pytest.approx(expected.jacobian[:, :, :4], rel=1e-6, abs=1e-7)
    assert not found.jacobian[:, :, [8, 17]].any()


def test_a_trial_without_a_pose_has_no_slope_and_spoils_no_other(small_model: LaxityModel) -> None:
    # Nothing resists: the Hessian of the lost trial is singular.
    model = replace(small_model, effects=(compression(),))
    theta = np.r_[np.zeros(4), small_model.parameters.center[4:], 0.0]
    found = model.predict(theta)
    assert found.pose_jacobian is not None
    assert not found.is_converged.any()
    assert np.isnan(found.pose_jacobian[..., -1]).all()
