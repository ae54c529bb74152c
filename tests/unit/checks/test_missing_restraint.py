"""What is missing where trials have no equilibrium: its size, its errors, the structure named."""

from dataclasses import replace

import numpy as np
import pytest

from identknee.checks.missing_restraint import missing_restraint_findings
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, add_noise, laxity_rmse
from identknee.model.effects.effect import Effect
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.model.missing_wrench import unbalanced_load, wrench_at_measured_poses
from identknee.runs.declare import Array
from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee

HIDDEN, STIFFNESS, STRAIN = "popliteofibular", 1.5, 2.0


@pytest.fixture(scope="module")
def plain() -> LaxityModel:
    """The reference knee without the LCL, at one flexion angle."""
    trials = load_protocol("seed63").select([0, 2, 4, 5, 6, 8, 10, 11, 14, 16, 18, 21])
    return LaxityModel(
        knee=reference_knee(), protocol=replace(trials, state=("cut: LCL",) * trials.n)
    )


@pytest.fixture(scope="module")
def truth(plain: LaxityModel) -> tuple[LaxityModel, Array]:
    """The same with a structure that holds it, and its parameters."""
    effect = effect_named(plain.knee, HIDDEN)
    model = replace(plain, effects=(effect,))
    values = np.zeros(effect.parameters.n)
    values[:2] = STIFFNESS, STRAIN
    return model, np.r_[plain.parameters.start, values]


@pytest.fixture(scope="module")
def laxity(truth: tuple[LaxityModel, Array]) -> Laxity:
    model, theta = truth
    made = model.simulate(theta)
    assert np.isfinite(made.coordinates).all()
    return made


def test_loads_balance_in_equilibrium(truth: tuple[LaxityModel, Array]) -> None:
    model, theta = truth
    assert np.abs(unbalanced_load(model, model.predict(theta))).max() < 1e-6


def test_the_missing_wrench_is_the_pull_of_the_structure_left_out(
    plain: LaxityModel, truth: tuple[LaxityModel, Array], laxity: Laxity
) -> None:
    model, theta = truth
    found = wrench_at_measured_poses(plain, laxity, plain.parameters.start, _sd(laxity, 0.3), 0.0)
    setting = model.setting(theta)
    assert not plain.predict(plain.parameters.start).is_converged.all()
    # At an exact pose all other forces balance without it.
    (effect,) = model.effects
    values = theta[plain.parameters.n :]
    columns = effect.gradient_columns(  # type: ignore[attr-defined]
        setting, values, setting.flexion[model.paths.trial_node], model.predict(theta).poses
    )
    np.testing.assert_allclose(found.wrench, -STIFFNESS * columns[:, :, 0], rtol=1e-6, atol=1e-3)


def test_its_covariance_is_that_of_small_errors_of_the_poses(
    plain: LaxityModel, laxity: Laxity
) -> None:
    theta, sd = plain.parameters.start, 1e-4
    at = wrench_at_measured_poses(plain, laxity, theta, _sd(laxity, sd), 0.0)
    squares = []
    for seed in range(5):
        noisy = add_noise(laxity, sd_mm=sd, sd_deg=sd, seed=seed)
        found = wrench_at_measured_poses(plain, noisy, theta, _sd(laxity, sd), 0.0)
        away = found.wrench - at.wrench
        squares.append(np.einsum("ni,nij,nj->n", away, np.linalg.inv(at.covariance), away))
    n = np.size(squares)
    # The mean of n chi-squares of 5 degrees of freedom, within 4 standard errors.
    assert np.mean(squares) == pytest.approx(5.0, abs=4.0 * np.sqrt(10.0 / n))


@pytest.mark.parametrize("sd", [0.0, 0.3])
def test_the_structure_left_out_is_named_first(
    plain: LaxityModel, laxity: Laxity, sd: float
) -> None:
    data = add_noise(laxity, sd_mm=sd, sd_deg=sd, seed=1) if sd else laxity
    prediction = plain.predict(plain.parameters.start)
    (found,) = missing_restraint_findings(plain, data, prediction, laxity_rmse(data, laxity))
    n_lost = int((~prediction.is_converged).sum())
    assert found.code == "missing-restraint"
    assert len(found.values["trials"]) == n_lost
    assert found.values["structures"][0] == HIDDEN
    assert found.values["shares"][0] > 0.97
    assert found.values["n_held"][0] == n_lost


def test_nothing_is_missing_where_every_trial_has_an_equilibrium(
    truth: tuple[LaxityModel, Array], laxity: Laxity
) -> None:
    model, theta = truth
    error = laxity_rmse(laxity, laxity)
    assert missing_restraint_findings(model, laxity, model.predict(theta), error) == ()


def test_poses_counted_from_a_zero_say_nothing(plain: LaxityModel, laxity: Laxity) -> None:
    prediction = plain.predict(plain.parameters.start)
    error = laxity_rmse(laxity, laxity)
    relative = replace(laxity, zero="unloaded")
    assert missing_restraint_findings(plain, relative, prediction, error) == ()


def test_where_anatomy_is_not_found_no_structure_is_named(
    plain: LaxityModel, laxity: Laxity, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(_knee: Knee) -> tuple[Effect, ...]:
        raise ValueError("the femoral surface has no posterior condyle on the lateral side")

    monkeypatch.setattr("identknee.checks.missing_restraint.library", without)
    prediction = plain.predict(plain.parameters.start)
    (found,) = missing_restraint_findings(plain, laxity, prediction, laxity_rmse(laxity, laxity))
    assert found.values["structures"] == []


def _sd(laxity: Laxity, value: float) -> Array:
    return np.full((laxity.n, 5), value)
