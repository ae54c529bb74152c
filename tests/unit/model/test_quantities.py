"""Ligament forces and laxities as quantities: exact gradients, one simulation for all of them."""

import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from posed_knees import FIFTH, NAMES, posed_reference
from small_knee import small_knee, small_protocol
from tolerances import CLOSED_FORM

from identknee.laxity.protocol import Protocol
from identknee.model import laxity_model as joint
from identknee.model import quantities
from identknee.model.laxity_model import LaxityModel
from identknee.model.quantities import (
    LigamentForce,
    PredictedLaxity,
    ligament_forces,
    predicted_quantities,
    quantity_named,
    tension_jacobian,
    tensions_of,
)
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array

# Differences of sixth order over steps of 1e-5 kN or %: rounding of poses over the step.
HIGH_ORDER = 1e-7
WEIGHTS = (3 / 4, -3 / 20, 1 / 60)
STEP = 1e-5
TRIAL = "anterior"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> LaxityModel:
    cache = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joint, "cache_folder", lambda: cache)
        return LaxityModel(knee=small_knee(), protocol=small_protocol())


def _difference(function: Callable[[Array], Array], theta: Array, k: int) -> Array:
    """Central difference of sixth order."""
    move = STEP * np.eye(theta.size)[k]
    steps = enumerate(WEIGHTS, 1)
    ends = [w * (function(theta + i * move) - function(theta - i * move)) for i, w in steps]
    return np.asarray(sum(ends) / STEP)


@pytest.mark.parametrize("factor", [1.0, 1.02])
def test_gradients_are_those_of_high_order_differences(small: LaxityModel, factor: float) -> None:
    theta = small.parameters.center * factor
    found = predicted_quantities(small, theta)
    assert found.tensions.shape == (6, 4)

    def tensions(at: Array) -> Array:
        return tensions_of(small, small.predict(at, derivatives=False))

    def coordinates(at: Array) -> Array:
        return small.predict(at, derivatives=False).coordinates

    for k in range(theta.size):
        for function, exact in (
            (tensions, found.tension_jacobian),
            (coordinates, found.coordinate_jacobian),
        ):
            error = np.abs(_difference(function, theta, k) - exact[:, :, k]).max()
            assert error <= HIGH_ORDER * np.abs(exact[:, :, k]).max()


def test_a_force_and_a_laxity_are_entries_of_the_whole(small: LaxityModel) -> None:
    theta = small.parameters.center
    found = predicted_quantities(small, theta)
    trial = small.protocol.trials.index(TRIAL)
    force = LigamentForce(model=small, ligament="outer", trial=TRIAL)
    value, gradient = force.evaluate(theta)
    assert (force.name, force.unit) == ("outer.tension_N@anterior", "N")
    assert value == found.tensions[trial, 2] > 0.0
    np.testing.assert_array_equal(gradient, found.tension_jacobian[trial, 2])
    laxity = PredictedLaxity(model=small, coordinate="anterior_drawer_mm", trial=TRIAL)
    value, gradient = laxity.evaluate(theta)
    assert (laxity.name, laxity.unit) == ("anterior_drawer_mm@anterior", "mm")
    assert value == found.coordinates[trial, 1]
    np.testing.assert_array_equal(gradient, found.coordinate_jacobian[trial, 1])


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Array]:
    """Every theta that a model was simulated at."""
    calls: list[Array] = []
    predict = LaxityModel.predict

    def counted(self: LaxityModel, theta: Array, *, derivatives: bool = True) -> object:
        calls.append(theta)
        return predict(self, theta, derivatives=derivatives)

    monkeypatch.setattr(LaxityModel, "predict", counted)
    quantities._predicted.cache_clear()
    return calls


def test_many_at_one_theta_cost_one_simulation(small: LaxityModel, calls: list[Array]) -> None:
    theta = small.parameters.center * 1.01
    forces = ligament_forces(small)
    assert len(forces) == 24
    # Twice, and from copies of theta.
    values = [force.evaluate(np.array(theta))[0] for force in [*forces, *forces]]
    assert len(calls) == 1
    expected = tensions_of(small, small.predict(theta)).ravel()
    np.testing.assert_array_equal(values, np.r_[expected, expected])


def test_untested_loads_are_another_protocol(small: LaxityModel) -> None:
    untested = Protocol(
        name="untested",
        trials=("pulled",),
        flexion_deg=np.array([4.0]),
        loads=np.array([[0.2, 0, 20.0, 0, 0]]),
    )
    forces = ligament_forces(small, untested)
    assert [force.trial for force in forces] == ["pulled"] * 4
    theta = small.parameters.center
    expected = small.with_protocol(untested)
    values = [force.evaluate(theta)[0] for force in forces]
    np.testing.assert_allclose(
        values, tensions_of(expected, expected.predict(theta))[0], rtol=1e-12
    )


def test_a_trial_without_equilibrium_has_no_value_and_leaves_the_others_theirs(
    small: LaxityModel,
) -> None:
    loads = np.array(small.protocol.loads)
    loads[1] = [30.0, 0, 0, 0, 0]
    broken = small.with_protocol(replace(small.protocol, loads=loads))
    theta = small.parameters.center
    assert not broken.predict(theta).is_converged[1]
    value, gradient = LigamentForce(model=broken, ligament="back", trial="internal").evaluate(theta)
    assert np.isnan(value)
    assert np.isnan(gradient).all()
    value, gradient = LigamentForce(model=broken, ligament="back", trial=TRIAL).evaluate(theta)
    assert np.isfinite([value, *gradient]).all()


def test_any_number_of_ligaments_of_any_name() -> None:
    model = LaxityModel(knee=posed_reference(), protocol=small_protocol().select([0, 3]))
    forces = ligament_forces(model)
    assert [x.ligament for x in forces[:5]] == [*NAMES, FIFTH.name]
    gradients = [force.evaluate(model.parameters.center)[1] for force in forces]
    assert np.shape(gradients) == (10, 10)
    assert np.isfinite(gradients).all()


def test_forces_cross_to_other_processes(small: LaxityModel) -> None:
    force = LigamentForce(model=small, ligament="front", trial=TRIAL)
    again = pickle.loads(pickle.dumps(force))
    value, gradient = again.evaluate(small.parameters.center)
    expected, slope = force.evaluate(small.parameters.center)
    assert value == pytest.approx(expected, rel=CLOSED_FORM)
    np.testing.assert_allclose(gradient, slope, rtol=CLOSED_FORM)


def test_names_are_read_back(small: LaxityModel) -> None:
    laxity = PredictedLaxity(model=small, coordinate="varus_deg", trial=TRIAL)
    named: list[LigamentForce | PredictedLaxity] = [*ligament_forces(small)[:2], laxity]
    for quantity in named:
        again = quantity_named(small, quantity.name)
        assert type(again) is type(quantity)
        assert again.name == quantity.name


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("front", "is not the name of a predicted quantity"),
        ("ACL.tension_N@anterior", "there is no ligament 'ACL'; there are front, back"),
        ("front.tension_N@nowhere", "there is no trial 'nowhere'; there are unloaded"),
        ("varus@anterior", "there is no coordinate 'varus'; there are lateral_shift_mm"),
    ],
)
def test_what_does_not_exist_is_named(small: LaxityModel, name: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        quantity_named(small, name)


def test_residuals_and_quantities_share_their_simulation(
    small: LaxityModel, calls: list[Array]
) -> None:
    """Whichever is asked first, for a trial of the data; also where a process is sent both."""
    problem = LaxityResiduals(model=small, laxity=small.simulate(small.parameters.center))
    together = problem, quantity_named(problem.model, f"front.tension_N@{TRIAL}")
    for residuals, force in (together, pickle.loads(pickle.dumps(together))):
        calls.clear()
        first, second = small.parameters.center * 1.02, small.parameters.center * 1.03
        residuals.residuals(first)
        force.evaluate(first)
        force.evaluate(second)
        residuals.residuals(second)
        residuals.jacobian(second)
        assert len(calls) == 2
        alone = LaxityResiduals(model=replace(small), laxity=problem.laxity)
        np.testing.assert_array_equal(residuals.residuals(second), alone.residuals(second))


def test_derivatives_of_tensions_need_those_of_the_prediction(small: LaxityModel) -> None:
    found = small.predict(small.parameters.center, derivatives=False)
    with pytest.raises(ValueError, match="only where the prediction has them"):
        tension_jacobian(small, found)
