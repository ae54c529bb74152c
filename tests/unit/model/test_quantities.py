"""Predictions by name: what each is, exact gradients, one simulation for all of them."""

import pickle
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from posed_knees import FIFTH, NAMES, posed_reference
from small_knee import small_protocol
from tolerances import CLOSED_FORM

from identknee.laxity.protocol import Protocol
from identknee.model import quantities
from identknee.model.contact_loads import contact_jacobian, contact_values
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import structure_loads, tensions_of
from identknee.model.quantities import force_names, ligament_forces, quantity_named
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array

# Differences of sixth order over steps of 1e-5 kN or %: rounding of poses over the step.
HIGH_ORDER = 1e-7
WEIGHTS = (3 / 4, -3 / 20, 1 / 60)
STEP = 1e-5
TRIAL = "anterior"


def _difference(function: Callable[[Array], Array], theta: Array, k: int) -> Array:
    """Central difference of sixth order."""
    move = STEP * np.eye(theta.size)[k]
    steps = enumerate(WEIGHTS, 1)
    ends = [w * (function(theta + i * move) - function(theta - i * move)) for i, w in steps]
    return np.asarray(sum(ends) / STEP)


@pytest.mark.parametrize("factor", [1.0, 1.02])
def test_gradients_are_those_of_high_order_differences(
    small_model: LaxityModel, factor: float
) -> None:
    theta = small_model.parameters.center * factor
    found = small_model.predict(theta)
    loads = structure_loads(small_model, found)
    assert found.jacobian is not None
    assert loads.tensions.shape == (6, 4)
    contact = contact_jacobian(small_model, found, range(6))

    def contacts(at: Array) -> Array:
        return contact_values(small_model.predict(at, derivatives=False))

    def tensions(at: Array) -> Array:
        return tensions_of(small_model, small_model.predict(at, derivatives=False))

    def coordinates(at: Array) -> Array:
        return small_model.predict(at, derivatives=False).coordinates

    for k in range(theta.size):
        for function, exact in (
            (tensions, loads.tension_jacobian),
            (coordinates, found.jacobian),
            (contacts, contact),
        ):
            error = np.abs(_difference(function, theta, k) - exact[..., k]).max()
            assert error <= HIGH_ORDER * np.abs(exact[..., k]).max()


def test_each_kind_is_an_entry_of_the_whole(small_model: LaxityModel) -> None:
    theta = small_model.parameters.center
    found = small_model.predict(theta)
    loads, trial = structure_loads(small_model, found), small_model.protocol.trials.index(TRIAL)
    assert found.jacobian is not None
    contact = contact_jacobian(small_model, found, [trial])[0]
    for what, unit, value, gradient in (
        ("outer.tension_N", "N", loads.tensions[trial, 2], loads.tension_jacobian[trial, 2]),
        ("outer.strain_pct", "%", loads.strains[trial, 2], loads.strain_jacobian[trial, 2]),
        ("contact.medial_N", "N", contact_values(found)[trial, 0, 0], contact[0, 0]),
        ("contact.lateral_x_mm", "mm", contact_values(found)[trial, 1, 1], contact[1, 1]),
        ("contact.lateral_z_mm", "mm", contact_values(found)[trial, 1, 3], contact[1, 3]),
        ("anterior_drawer_mm", "mm", found.coordinates[trial, 1], found.jacobian[trial, 1]),
    ):
        quantity = quantity_named(small_model, f"{what}@{TRIAL}")
        own, slopes = quantity.evaluate(theta)
        assert (quantity.name, quantity.unit) == (f"{what}@anterior", unit)
        assert own == pytest.approx(value, rel=CLOSED_FORM)
        assert own == pytest.approx(quantity.value(found), rel=CLOSED_FORM)
        assert own != 0.0
        np.testing.assert_allclose(slopes, gradient, rtol=CLOSED_FORM)


def test_strain_follows_from_tension_where_taut_and_is_negative_where_slack(
    small_model: LaxityModel,
) -> None:
    theta = small_model.parameters.vector({"front.reference_strain_pct": -14.0})
    loads = structure_loads(small_model, small_model.predict(theta))
    stiffness = 1000.0 * theta[:4]
    taut = loads.tensions > 0.0
    share = loads.tensions / stiffness
    toe = share < 0.03
    expected = np.where(toe, 200.0 * np.sqrt(0.03 * share), 100.0 * (share + 0.03))
    np.testing.assert_allclose(loads.strains[taut], expected[taut], rtol=1e-9)
    assert (~taut).any()
    assert (loads.strains[~taut] <= 0.0).all()
    # A slack ligament's strain moves with its reference strain, its tension does not.
    slack = ~taut[:, 0]
    assert (loads.strain_jacobian[slack, 0, 4] > 0.5).all()
    assert not loads.tension_jacobian[slack, 0].any()


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Array]:
    """Every theta that a model was simulated at."""
    calls: list[Array] = []
    predict = LaxityModel.predict

    def counted(self: LaxityModel, theta: Array, *, derivatives: bool = True) -> object:
        calls.append(theta)
        return predict(self, theta, derivatives=derivatives)

    monkeypatch.setattr(LaxityModel, "predict", counted)
    for kept in (quantities._prediction, quantities._structure_loads, quantities._contact_jacobian):
        kept.cache_clear()
    return calls


def test_many_at_one_theta_cost_one_simulation(
    small_model: LaxityModel, calls: list[Array]
) -> None:
    theta = small_model.parameters.center * 1.01
    forces = ligament_forces(small_model)
    assert len(forces) == 24
    # Twice, and from copies of theta.
    values = [force.evaluate(np.array(theta))[0] for force in [*forces, *forces]]
    assert len(calls) == 1
    expected = tensions_of(small_model, small_model.predict(theta)).ravel()
    np.testing.assert_array_equal(values, np.r_[expected, expected])


def test_untested_loads_are_another_protocol(small_model: LaxityModel) -> None:
    untested = Protocol(
        name="untested",
        trials=("pulled",),
        flexion_deg=np.array([4.0]),
        loads=np.array([[0.2, 0, 20.0, 0, 0]]),
    )
    forces = ligament_forces(small_model, untested)
    assert [force.trial for force in forces] == ["pulled"] * 4
    theta = small_model.parameters.center
    expected = small_model.with_protocol(untested)
    values = [force.evaluate(theta)[0] for force in forces]
    np.testing.assert_allclose(
        values, tensions_of(expected, expected.predict(theta))[0], rtol=1e-12
    )


def test_a_trial_without_equilibrium_has_no_value_and_leaves_the_others_theirs(
    small_model: LaxityModel,
) -> None:
    loads = np.array(small_model.protocol.loads)
    loads[1] = [30.0, 0, 0, 0, 0]
    broken = small_model.with_protocol(replace(small_model.protocol, loads=loads))
    theta = small_model.parameters.center
    assert not broken.predict(theta).is_converged[1]
    for what in ("back.tension_N", "back.strain_pct", "contact.medial_N", "contact.medial_x_mm"):
        quantity = quantity_named(broken, f"{what}@internal")
        value, gradient = quantity.evaluate(theta)
        assert np.isnan([value, quantity.value(broken.predict(theta)), *gradient]).all()
        value, gradient = quantity_named(broken, f"{what}@{TRIAL}").evaluate(theta)
        assert np.isfinite([value, *gradient]).all()


def test_any_number_of_ligaments_of_any_name() -> None:
    model = LaxityModel(knee=posed_reference(), protocol=small_protocol().select([0, 3]))
    forces = ligament_forces(model)
    names = [x.what.removesuffix(".tension_N") for x in forces[:5]]
    assert names == [*NAMES, FIFTH.name]
    gradients = [force.evaluate(model.parameters.center)[1] for force in forces]
    assert np.shape(gradients) == (10, 10)
    assert np.isfinite(gradients).all()


def test_forces_cross_to_other_processes(small_model: LaxityModel) -> None:
    force = quantity_named(small_model, f"front.tension_N@{TRIAL}")
    again = pickle.loads(pickle.dumps(force))
    value, gradient = again.evaluate(small_model.parameters.center)
    expected, slope = force.evaluate(small_model.parameters.center)
    assert value == pytest.approx(expected, rel=CLOSED_FORM)
    np.testing.assert_allclose(gradient, slope, rtol=CLOSED_FORM)


def test_names_are_read_back(small_model: LaxityModel) -> None:
    names = [
        *force_names(small_model, [TRIAL]),
        f"contact.lateral_N@{TRIAL}",
        f"back.strain_pct@{TRIAL}",
        f"varus_deg@{TRIAL}",
    ]
    assert [quantity_named(small_model, x).name for x in names] == names
    assert [x.name for x in ligament_forces(small_model)] == force_names(
        small_model, small_model.protocol.trials
    )


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("front", "is not the name of a predicted quantity"),
        ("ACL.tension_N@anterior", "there is no ligament 'ACL'; there are front, back"),
        ("front.tension_N@nowhere", "there is no trial 'nowhere'; there are unloaded"),
        ("varus@anterior", "there is no coordinate 'varus'; there are lateral_shift_mm"),
        ("contact.force_N@anterior", r"write NAME.tension_N@TRIAL .* contact.medial_N@TRIAL"),
        ("contact.medial_mm@anterior", r"contact.medial_x_mm@TRIAL"),
        ("front.stiffness_kN@anterior", "is not the name of a predicted quantity"),
        ("contact.tension_N@anterior", "there is no ligament 'contact'"),
    ],
)
def test_what_does_not_exist_is_named(small_model: LaxityModel, name: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        quantity_named(small_model, name)


def test_residuals_and_quantities_share_their_simulation(
    small_model: LaxityModel, calls: list[Array]
) -> None:
    """Whichever is asked first, for a trial of the data; also where a process is sent both."""
    problem = LaxityResiduals(
        model=small_model, laxity=small_model.simulate(small_model.parameters.center)
    )
    together = problem, quantity_named(problem.model, f"front.tension_N@{TRIAL}")
    for residuals, force in (together, pickle.loads(pickle.dumps(together))):
        calls.clear()
        first, second = small_model.parameters.center * 1.02, small_model.parameters.center * 1.03
        residuals.residuals(first)
        force.evaluate(first)
        force.evaluate(second)
        residuals.residuals(second)
        residuals.jacobian(second)
        assert len(calls) == 2
        alone = LaxityResiduals(model=replace(small_model), laxity=problem.laxity)
        np.testing.assert_array_equal(residuals.residuals(second), alone.residuals(second))


def test_derivatives_of_tensions_need_those_of_the_prediction(small_model: LaxityModel) -> None:
    found = small_model.predict(small_model.parameters.center, derivatives=False)
    with pytest.raises(ValueError, match="prediction has"):
        structure_loads(small_model, found)
    with pytest.raises(ValueError, match="prediction has"):
        contact_jacobian(small_model, found, [0])
