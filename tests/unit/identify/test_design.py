"""Advice on trials to add: exact where the model is linear, near where it is not, and honest."""

from dataclasses import replace

import numpy as np
import pytest
from problems import ClosedForm, Linear, plain_parameters
from trial_formulas import FormulaTrials, linear_trials

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import (
    ParameterQuantity,
    Problem,
    UserQuantity,
    with_nuisance_priors,
    without_priors,
)
from identknee.identify.design import (
    ChosenTrials,
    design,
    linearised,
    linearised_candidates,
)
from identknee.identify.design_criteria import (
    CRITERIA,
    Criterion,
    LocalLoss,
    OfferedTrials,
    Step,
    WithTrials,
    directions_across,
)
from identknee.identify.information import scaled_units
from identknee.identify.profile.result import SideStatus
from identknee.runs.declare import Array
from identknee.runs.executors import threads

Z95 = 1.959963984540054
# Ends of profiles are solved to 1e-3 of a half-width or better; the prediction reads them off.
ENDS = 2e-3


def _linear(size: float = 1.0) -> Linear:
    rng = np.random.default_rng(7)
    matrix = size * rng.normal(size=(6, 3))
    return Linear(parameters=plain_parameters(3, -1e3, 1e3), matrix=matrix, data=rng.normal(size=6))


def _best(problem: Linear) -> Array:
    return np.asarray(np.linalg.lstsq(problem.matrix, problem.data)[0])


BLOCKS = np.random.default_rng(8).normal(size=(7, 2, 3))


@pytest.mark.parametrize("criterion", CRITERIA)
def test_on_a_linear_model_predicted_is_achieved_is_the_formula(criterion: Criterion) -> None:
    problem = _linear()
    found = design(problem, _best(problem), linear_trials(BLOCKS), n_trials=3, criterion=criterion)
    assert found.targets == problem.parameters.names
    assert len(found.trials) == 3
    assert found.excluded == ()
    information = problem.matrix.T @ problem.matrix
    for step in range(4):
        blocks = BLOCKS[list(found.chosen[:step])].reshape(-1, 3)
        sd = np.sqrt(np.diag(np.linalg.inv(information + blocks.T @ blocks)))
        # Information of 1e-6 is added in every direction.
        np.testing.assert_allclose(found.sds[step], sd, rtol=1e-5)
        widths = found.predicted[step, :, 1] - found.predicted[step, :, 0]
        np.testing.assert_allclose(widths, 2.0 * Z95 * sd, rtol=ENDS)
    for predicted, after in zip(found.predicted[-1], found.after.values(), strict=True):
        assert after.lower is not None
        assert after.upper is not None
        width = after.upper - after.lower
        np.testing.assert_allclose(predicted, [after.lower, after.upper], atol=ENDS * width)
    assert (np.diff(found.losses) < 0).all()
    assert found.losses[1] == pytest.approx(np.nanmin(found.alone))


def test_the_target_asked_for_is_the_one_that_shrinks() -> None:
    problem = _linear()
    sd = {}
    for i, name in enumerate(problem.parameters.names):
        target = ParameterQuantity(parameters=problem.parameters, name=name)
        found = design(problem, _best(problem), linear_trials(BLOCKS), n_trials=2, targets=[target])
        assert found.targets == (name,)
        blocks = BLOCKS[list(found.chosen)].reshape(-1, 3)
        information = problem.matrix.T @ problem.matrix + blocks.T @ blocks
        sd[i] = np.sqrt(np.diag(np.linalg.inv(information)))
    for i in sd:
        assert all(sd[i][i] <= other[i] * 1.001 for other in sd.values())


def _decay(times: Array, size: float = 20.0) -> tuple[ClosedForm, FormulaTrials]:
    """Amplitude and rate of a decay; the trials made are late, when only their mixture matters."""
    truth = np.array([3.0, 1.2])

    def curve(theta: Array, at: Array) -> Array:
        return np.asarray(size * theta[0] * np.exp(-theta[1] * at))

    def slopes(theta: Array, at: Array) -> Array:
        falling = size * np.exp(-theta[1] * at)
        return np.stack([falling, -theta[0] * at * falling], axis=-1)

    made = np.array([1.6, 1.8, 2.0])
    problem = ClosedForm(
        name="decay",
        parameters=plain_parameters(2, 0.0, 8.0),
        start=truth,
        minimum=truth,
        lowest=0.0,
        residuals_at=lambda theta: curve(theta, made) - curve(truth, made),
        jacobian_at=lambda theta: slopes(theta, made),
    )
    trials = FormulaTrials(
        names=tuple(f"at {t:g}" for t in times),
        values=lambda theta: curve(theta, times)[:, None],
        jacobian=lambda theta: slopes(theta, times)[:, None, :],
    )
    return problem, trials


def test_an_open_interval_is_closed_as_predicted() -> None:
    problem, trials = _decay(np.array([0.05, 0.5, 1.0, 1.7, 3.0]))
    found = design(problem, problem.minimum, trials, n_trials=2)
    assert "x0.value_pct" in found.targets
    before, after = found.before["x0.value_pct"], found.after["x0.value_pct"]
    assert before.upper_status is SideStatus.OPEN_AT_BOUND
    assert np.isnan(found.predicted[0, 0, 1])
    assert after.upper_status is SideStatus.CLOSED
    assert "at 3" not in found.trials
    assert after.lower is not None
    assert after.upper is not None
    # One linear step of the other parameter from points as far apart as a profile's.
    width = after.upper - after.lower
    np.testing.assert_allclose(found.predicted[-1, 0], [after.lower, after.upper], atol=0.1 * width)


def test_ends_that_no_candidate_closes_are_named() -> None:
    """One that a candidate closes is not among them, and neither is one that is closed already."""
    matrix = np.array([[1.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    problem = Linear(parameters=plain_parameters(3), matrix=matrix, data=np.zeros(2))
    blocks = np.array([[[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]])
    found = design(problem, np.zeros(3), linear_trials(blocks), n_trials=2)
    assert found.targets == ("x1.value_pct", "x2.value_pct")
    assert {(x.target, x.end) for x in found.unbounded} == {
        ("x2.value_pct", "below"),
        ("x2.value_pct", "above"),
    }
    with_it = np.append(blocks, [[[0.0, 0.0, 1.0]]], axis=0)
    assert not design(problem, np.zeros(3), linear_trials(with_it), n_trials=2).unbounded


def test_one_end_may_be_out_of_reach_alone() -> None:
    problem, late = _decay(np.array([2.5, 3.0]))
    found = design(problem, problem.minimum, late, n_trials=1)
    assert ("x0.value_pct", "above") in {(x.target, x.end) for x in found.unbounded}
    assert ("x0.value_pct", "below") not in {(x.target, x.end) for x in found.unbounded}
    problem, early = _decay(np.array([0.05, 3.0]))
    assert not design(problem, problem.minimum, early, n_trials=1).unbounded


def test_the_width_beats_the_variance_where_the_interval_is_open() -> None:
    """Or equals it: the variance at the best fit is not what bounds a curved valley."""
    problem, trials = _decay(np.linspace(0.05, 3.0, 12))
    target = [ParameterQuantity(parameters=problem.parameters, name="x0.value_pct")]
    widths = []
    for criterion in ("width", "c"):
        after = design(
            problem, problem.minimum, trials, n_trials=1, targets=target, criterion=criterion
        ).after["x0.value_pct"]
        assert after.lower is not None
        widths.append(8.0 if after.upper is None else after.upper - after.lower)
    assert widths[0] <= widths[1] * 1.05


def test_candidates_without_prediction_are_excluded_and_said() -> None:
    problem = _linear()
    best = _best(problem)

    def beyond(trial: int, theta: Array) -> float:
        if trial == 2:
            return 1.0
        return float(theta[0] - best[0]) - 0.5 if trial == 5 else -1.0

    found = design(problem, best, linear_trials(BLOCKS, beyond=beyond), n_trials=4)
    assert [x.name for x in found.excluded] == ["trial 2", "trial 5"]
    assert [x.at_fit for x in found.excluded] == [True, False]
    assert found.excluded[0].sentence.startswith("trial 2 ")
    some = found.excluded[1]
    assert 0 < some.failures < some.tried
    assert f"{some.failures} of {some.tried} " in some.sentence
    assert not {"trial 2", "trial 5"} & set(found.trials)
    assert np.isnan(found.alone[[2, 5]]).all()


def test_any_function_can_be_the_target() -> None:
    problem = _linear()
    ratio = UserQuantity(name="sum", unit="%", function=lambda theta: float(theta.sum()))
    found = design(
        problem, _best(problem), linear_trials(BLOCKS), n_trials=1, targets=[ratio], criterion="c"
    )
    information = problem.matrix.T @ problem.matrix
    expected = [np.sqrt(np.linalg.inv(information + block.T @ block).sum()) for block in BLOCKS]
    assert found.chosen[0] == int(np.argmin(expected))
    assert found.sds[1, 0] == pytest.approx(min(expected), rel=1e-4)


def _same(first: ChosenTrials, second: ChosenTrials) -> bool:
    return first.chosen == second.chosen and np.array_equal(first.predicted, second.predicted)


def test_the_executor_does_not_matter() -> None:
    problem = _linear()
    args = (problem, _best(problem), linear_trials(BLOCKS))
    with threads(2) as executor:
        assert _same(design(*args, n_trials=2), design(*args, n_trials=2, executor=executor))


def test_bad_input_is_refused() -> None:
    problem = _linear()
    args = (problem, _best(problem), linear_trials(BLOCKS))
    with pytest.raises(ValueError, match=r"trials.* 1, got 0"):
        design(*args, n_trials=0)
    with pytest.raises(ValueError, match=r"'F'.* D, A, E, c, width"):
        design(*args, n_trials=1, criterion="F")  # type: ignore[arg-type]
    nothing = linear_trials(BLOCKS, beyond=lambda _, __: 1.0)
    with pytest.raises(ValueError, match="no candidate"):
        design(problem, _best(problem), nothing, n_trials=1)


def test_added_trials_are_residuals_like_others() -> None:
    problem, theta = _linear(), np.array([0.3, -0.2, 0.1])
    measured = np.zeros((3, 2))
    whole = WithTrials(
        problem=problem, candidates=linear_trials(BLOCKS), chosen=(4, 1, 4), measured=measured
    )
    rows = BLOCKS[[4, 1, 4]].reshape(-1, 3)
    expected = np.concatenate([problem.residuals(theta), rows @ theta])
    np.testing.assert_allclose(whole.residuals(theta), expected)
    np.testing.assert_allclose(whole.jacobian(theta), np.vstack([problem.matrix, rows]))
    # Also where the residuals were not asked for first.
    np.testing.assert_allclose(whole.jacobian(theta + 1.0), np.vstack([problem.matrix, rows]))
    assert whole.parameters is problem.parameters
    lost = replace(whole, candidates=linear_trials(BLOCKS, beyond=lambda i, _: i - 3.5))
    assert np.isinf(lost.residuals(theta)).all()
    assert lost.residuals(theta).size == expected.size


def test_losses_are_those_of_their_names() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(2, 5, 3))
    matrices = np.einsum("kmi,kmj->kij", root, root)
    gradients = rng.normal(size=(2, 3))
    inverse = np.linalg.inv(matrices)
    variances = np.einsum("ti,kij,tj->kt", gradients, inverse, gradients)
    expected: dict[Criterion, Array] = {
        "D": -np.log(np.linalg.det(matrices)),
        "A": np.trace(inverse, axis1=1, axis2=2),
        "E": np.linalg.eigvalsh(inverse)[:, -1],
        "c": np.log(variances).sum(axis=1),
    }
    for criterion, values in expected.items():
        loss = LocalLoss(criterion=criterion, gradients=gradients, is_of_interest=np.ones(3, bool))
        np.testing.assert_allclose(loss(matrices.reshape(2, -1)), values, rtol=1e-4)


def _with_nuisances() -> Problem:
    """Two parameters asked for between two nuisances, whose priors are part of the problem."""
    rng = np.random.default_rng(11)
    parameters = replace(
        plain_parameters(4, -1e3, 1e3),
        prior_sd=np.array([0.5, 2.0, 2.0, 0.3]),
        is_nuisance=np.array([True, False, False, True]),
    )
    matrix, data = rng.normal(size=(9, 4)), rng.normal(size=9)
    # Each nuisance does nearly what a parameter does: priors decide between them.
    matrix[:, [0, 3]] = matrix[:, [1, 2]] + 0.2 * matrix[:, [0, 3]]
    return with_nuisance_priors(Linear(parameters=parameters, matrix=matrix, data=data))


def test_straight_lines_are_the_problem_at_the_best_fit_and_itself_where_linear() -> None:
    problem, theta = _with_nuisances(), np.array([0.3, -0.2, 0.5, 0.1])
    blocks = np.random.default_rng(12).normal(size=(6, 2, 4))
    candidates = linear_trials(blocks)
    lines, offered = linearised(problem, theta), linearised_candidates(candidates, theta)
    elsewhere = theta + np.array([0.5, -0.4, 0.3, 0.2])
    np.testing.assert_allclose(lines.residuals(elsewhere), problem.residuals(elsewhere))
    np.testing.assert_allclose(lines.jacobian(elsewhere), problem.jacobian(elsewhere))
    for one, other in zip(
        offered.predict(elsewhere, [4, 1]), candidates.predict(elsewhere, [4, 1]), strict=True
    ):
        np.testing.assert_allclose(one, other)


@pytest.mark.parametrize("criterion", ["D", "A", "E"])
def test_nuisances_are_no_targets_and_are_integrated_out(criterion: Criterion) -> None:
    problem = _with_nuisances()
    blocks = np.random.default_rng(12).normal(size=(6, 2, 4))
    optimum = fit(problem, np.zeros(4)).theta
    found = design(problem, optimum, linear_trials(blocks), n_trials=1, criterion=criterion)
    assert found.targets == ("x1.value_pct", "x2.value_pct")
    jacobian = problem.jacobian(optimum)
    scales = np.outer(*2 * [scaled_units(problem.parameters, "typical")[1:3]])
    for block, loss in zip(blocks, found.alone, strict=True):
        covariance = np.linalg.inv(jacobian.T @ jacobian + block.T @ block)[1:3, 1:3] / scales
        sizes = np.linalg.eigvalsh(covariance)
        expected = {"D": np.log(sizes).sum(), "A": sizes.sum(), "E": sizes[-1]}
        assert loss == pytest.approx(expected[criterion], rel=1e-4)


def test_trials_that_share_errors_are_told_from_each_other() -> None:
    problem, blocks = _with_nuisances(), np.random.default_rng(12).normal(size=(6, 2, 4))
    optimum = fit(problem, np.zeros(4)).theta
    found = design(problem, optimum, linear_trials(blocks), n_trials=3, criterion="A")
    jacobian = problem.jacobian(optimum)
    scales = np.outer(*2 * [scaled_units(problem.parameters, "typical")[1:3]])
    for n, loss in enumerate(found.losses):
        added = blocks[list(found.chosen[:n])].reshape(-1, 4)
        covariance = np.linalg.inv(jacobian.T @ jacobian + added.T @ added)[1:3, 1:3] / scales
        assert loss == pytest.approx(np.trace(covariance), rel=1e-4)


def test_an_error_known_better_is_the_problem_with_half_its_prior() -> None:
    """And one more trial is the problem with that trial, in the same numbers."""
    problem, blocks = _with_nuisances(), np.random.default_rng(12).normal(size=(6, 2, 4))
    optimum = fit(problem, np.zeros(4)).theta
    found = design(problem, optimum, linear_trials(blocks), n_trials=1)
    parameters = problem.parameters
    assert found.narrowing.errors == ("x0", "x3")
    for place, now in zip((0, 3), found.narrowing.with_error_halved, strict=True):
        halved = np.array(parameters.prior_sd)
        halved[place] /= 2.0
        jacobian = _jacobian_with_prior(problem, halved)
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        sd = np.sqrt(np.diag(covariance)[1:3])
        np.testing.assert_allclose(now, 2.0 * Z95 * sd, rtol=ENDS)
    jacobian = problem.jacobian(optimum)
    for block, now in zip(blocks, found.narrowing.with_trial, strict=True):
        covariance = np.linalg.inv(jacobian.T @ jacobian + block.T @ block)
        sd = np.sqrt(np.diag(covariance)[1:3])
        np.testing.assert_allclose(now, 2.0 * Z95 * sd, rtol=ENDS)
    shares = [x["narrowing"] for x in found.ranking]
    assert shares == sorted(shares, reverse=True)
    assert {x["name"] for x in found.ranking} == {*found.names, *found.narrowing.errors}


STEPS = (
    Step(name="cut a", kind="cut", structure="a", trial="x"),
    Step(name="force b", kind="force", structure="b", trial="x"),
)


@pytest.mark.parametrize("has_nuisances", [False, True])
def test_a_step_of_another_kind_is_worth_what_it_would_measure(has_nuisances: bool) -> None:
    """It has fewer values than a trial, is not chosen, and is ranked by its cost."""
    problem: Problem = _with_nuisances() if has_nuisances else _linear()
    n = problem.parameters.n
    rng = np.random.default_rng(13)
    trials, other = rng.normal(size=(5, 2, n)), 20.0 * rng.normal(size=(2, 1, n))
    optimum = fit(problem, np.zeros(n)).theta
    offered = OfferedTrials(
        trials=linear_trials(trials),
        steps=STEPS,
        measured=replace(linear_trials(other), names=("cut a", "force b")),
        costs={"cut": 1e3},
    )
    found = design(problem, optimum, offered, n_trials=3)
    assert set(found.trials) <= set(linear_trials(trials).names)
    assert found.narrowing.with_trial.shape == (5, len(found.targets))
    assert found.narrowing.with_step is not None
    jacobian = problem.jacobian(optimum)
    is_asked = problem.parameters.is_of_interest
    for rows, widths in zip(
        (*trials, *other), (*found.narrowing.with_trial, *found.narrowing.with_step), strict=True
    ):
        covariance = np.linalg.inv(jacobian.T @ jacobian + rows.T @ rows)
        sd = np.sqrt(np.diag(covariance)[is_asked])
        np.testing.assert_allclose(widths, 2.0 * Z95 * sd, rtol=ENDS)
    per_cost = {x["name"]: x["per_cost"] for x in found.ranking}
    sizes = {x["name"]: x["narrowing"] for x in found.ranking}
    assert list(per_cost.values()) == sorted(per_cost.values(), reverse=True)
    assert found.ranking[-1]["name"] == "cut a"
    assert sizes["cut a"] > min(sizes.values())
    assert per_cost.pop("cut a") < 1e-3
    assert per_cost == {x: size for x, size in sizes.items() if x != "cut a"}


def _jacobian_with_prior(problem: Problem, prior_sd: Array) -> Array:
    nuisances = np.flatnonzero(~problem.parameters.is_of_interest)
    data = without_priors(problem).jacobian(np.zeros(problem.parameters.n))
    return np.vstack([data, np.diag(1.0 / prior_sd)[nuisances]])


def test_without_a_parameter_of_interest_there_is_nothing_to_design() -> None:
    problem = _linear()
    only = replace(problem, parameters=problem.parameters.as_nuisances())
    with pytest.raises(ValueError, match="are fixed"):
        design(only, np.zeros(3), linear_trials(BLOCKS), n_trials=1)


def test_directions_across_leave_the_target_as_it_is() -> None:
    gradients = np.random.default_rng(0).normal(size=(5, 4))
    across = directions_across(gradients)
    assert across.shape == (5, 4, 3)
    np.testing.assert_allclose(np.einsum("si,sia->sa", gradients, across), 0.0, atol=1e-12)
    np.testing.assert_allclose(
        np.einsum("sia,sib->sab", across, across), [np.eye(3)] * 5, atol=1e-12
    )
