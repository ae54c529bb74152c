"""Tensions, strains and contact of groups, effects and nuisances: slopes, sums and other knees."""

from dataclasses import replace

import numpy as np
import pytest
from few_places import few_places
from slow_cases import some_slow
from small_knee import small_knee, small_protocol
from tolerances import CLOSED_FORM
from wrapped_knee import wrapped_knee

import identknee as ik
from identknee.laxity.table import Laxity
from identknee.model.contact_loads import contact_jacobian, contact_values
from identknee.model.effects.library import effect_named
from identknee.model.effects.structures import structure_at
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import (
    structure_loads,
    structure_names,
    structure_values,
    values_of_structures,
)
from identknee.model.nuisances import contact_rounding
from identknee.model.prediction import Prediction
from identknee.model.quantities import force_names, ligament_forces, quantity_named
from identknee.runs.declare import Array
from identknee.subject.knee import Knee, Uncertainty
from identknee.subject.ligament import Ligament

EVERYTHING = Uncertainty(
    insertions_mm=2.0,
    registration_deg=2.0,
    registration_mm=2.0,
    load_axes_deg=2.0,
    load_gain=0.05,
    flexion_deg=1.0,
    contact_modulus=0.3,
    contact_exponent=0.2,
    toe_region=0.3,
    reference_pose_deg=1.0,
    reference_pose_mm=1.0,
)
# Standard deviations; differences err by its square and by rounding of poses over it, together by
# at most 2e-7 of the largest slope of a kind.
STEP, SHARE = 1e-4, 1e-6


def _wrapped() -> tuple[LaxityModel, Array]:
    """The same with ligaments around obstacles of both bones."""
    return _reference(wrapped_knee())


def _reference(knee: Knee | None = None) -> tuple[LaxityModel, Array]:
    """The reference knee with two structures, split ligaments and everything uncertain."""
    knee = (knee or ik.reference_knee()).with_uncertainty(EVERYTHING)
    protocol = ik.load_protocol("table2").select([0, 3])
    model = LaxityModel(knee=knee, protocol=protocol)
    effects = [effect_named(knee, x) for x in ("popliteofibular", "posterior_capsule", "bundles")]
    model = model.with_effects([*effects, effect_named(knee, "meniscus"), *model.effects])
    theta = np.array(model.parameters.start)
    for name, value in {
        "popliteofibular.stiffness_kN": 1.5,
        "popliteofibular.reference_strain_pct": 5.0,
        "posterior_capsule.medial_stiffness_kN": 2.0,
        "posterior_capsule.lateral_stiffness_kN": 1.0,
        "posterior_capsule.reference_strain_pct": 6.0,
        "meniscus.medial_N_per_mm": 5.0,
        "bundles.MCL_strain_spread_pct": 4.0,
    }.items():
        theta[model.parameters.index(name)] = value
    return model, _displaced(model, theta)


def _bundles() -> tuple[LaxityModel, Array]:
    """The knee of bundles, its registration and insertions uncertain, from its measured poses."""
    stated = Uncertainty(insertions_mm=4.0, registration_deg=4.0, registration_mm=4.0)
    knee = ik.example("s192803_bundles").with_uncertainty(stated)
    laxity = _few(ik.example_laxity("s192803"))
    model = LaxityModel(knee=knee, protocol=laxity.protocol).with_tests(laxity)
    return model, _displaced(model, np.array(model.parameters.start))


def _few(laxity: Laxity) -> Laxity:
    return replace(
        laxity, protocol=laxity.protocol.select([0, 1]), coordinates=laxity.coordinates[:2]
    )


def _displaced(model: LaxityModel, theta: Array) -> Array:
    """Theta with nuisances a tenth of a standard deviation from the middle of their priors."""
    p = model.parameters
    drawn = np.random.default_rng(0).standard_normal(p.n) * ~p.is_of_interest
    return np.asarray(theta + 0.1 * p.prior_sd_in_own_units * drawn)


MODELS = {"reference": _reference, "bundles": _bundles, "wrapped": _wrapped}


def _values(model: LaxityModel, found: Prediction) -> tuple[Array, Array, Array]:
    """Tensions and strains of all structures, ``(n, k)``, and contact, ``(n, 2, 4)``."""
    tensions, strains = values_of_structures(model, found, structure_names(model))
    return tensions, strains, contact_values(found)


@pytest.mark.parametrize("name", some_slow(MODELS, ["reference", "wrapped"]))
def test_slopes_by_every_parameter_are_those_of_differences(name: str) -> None:
    model, theta = MODELS[name]()
    found, p = model.predict(theta), model.parameters
    assert found.all_converged
    loads = structure_loads(model, found)
    contact = contact_jacobian(model, found, range(len(found.codes)))
    sds = p.prior_sd_in_own_units
    slopes = loads.tension_jacobian * sds, loads.strain_jacobian * sds, contact * sds
    for values, own in zip(
        _values(model, found), (loads.tensions, loads.strains, contact_values(found)), strict=True
    ):
        np.testing.assert_allclose(own, values, rtol=CLOSED_FORM, atol=1e-9)
    sizes = [np.abs(x).max() for x in slopes]
    assert min(sizes) > 0.1
    for i in few_places(p.names):
        move = STEP * sds[i] * np.eye(p.n)[i]
        low, high = (
            _values(model, model.predict(theta + x, derivatives=False)) for x in (-move, move)
        )
        for less, more, exact, size in zip(low, high, slopes, sizes, strict=True):
            error = np.abs((more - less) / (2.0 * STEP) - exact[..., i]).max()
            assert error <= SHARE * size, (p.names[i], error, size)


def test_a_group_pulls_as_its_bundles_do_together() -> None:
    model, theta = _bundles()
    found = model.predict(theta)
    loads = structure_loads(model, found)
    places = {x: i for i, x in enumerate(loads.names)}
    stiffness = {x.name: x.stiffness_kN for x in model.knee.ligaments}
    assert model.knee.groups
    for group in model.knee.groups:
        own, k = [places[x] for x in group.members], places[group.name]
        weights = np.array([stiffness[x] for x in group.members])
        for whole, parts in (
            (loads.tensions[:, k], loads.tensions[:, own].sum(axis=1)),
            (loads.tension_jacobian[:, k], loads.tension_jacobian[:, own].sum(axis=1)),
            (loads.strains[:, k], np.average(loads.strains[:, own], axis=1, weights=weights)),
            (
                loads.strain_jacobian[:, k],
                np.average(loads.strain_jacobian[:, own], axis=1, weights=weights),
            ),
        ):
            np.testing.assert_allclose(whole, parts, rtol=1e-9, atol=1e-9)
    # All ligaments in a trial are the groups, so that every line counts once.
    trial = model.protocol.trials[0]
    total = sum(quantity_named(model, x).value(found) for x in force_names(model, [trial]))
    assert total == pytest.approx(loads.tensions[0, : len(model.knee.ligaments)].sum())
    names = [x.what for x in ligament_forces(model)[: len(model.knee.groups)]]
    assert names == [f"{x.name}.tension_N" for x in model.knee.groups]


def test_a_group_without_stiffness_has_the_strain_of_one_with_a_little() -> None:
    model, theta = _bundles()
    strains, found = [], model.predict(theta, derivatives=False)
    for stiffness in (0.0, 1e-9):
        changed = np.array(theta)
        changed[model.parameters.index("ACL.stiffness_kN")] = stiffness
        # In the same pose.
        strains.append(structure_values(model, replace(found, theta=changed), "ACL")[1])
    np.testing.assert_allclose(strains[0], strains[1], rtol=1e-6)


def test_an_added_structure_pulls_as_a_ligament_there_would() -> None:
    knee = replace(small_knee(), contact_rounding_mm=contact_rounding(small_knee()))
    femur, tibia = np.array([2.0, 3.0, 15.0]), np.array([3.0, -14.0, 17.0])
    side = structure_at(knee, "side", [(femur, tibia)], stiffness_sd=1.0, sites_vary=False)
    model = LaxityModel(knee=knee, protocol=small_protocol(), effects=(side,))
    theta = model.parameters.vector({"side.stiffness_kN": 2.0, "side.reference_strain_pct": 5.0})
    ligament = Ligament(
        name="side", femur=femur, tibia=tibia, stiffness_kN=2.0, reference_strain_pct=5.0
    )
    other = LaxityModel(
        knee=knee.with_ligaments([*knee.ligaments, ligament]), protocol=small_protocol()
    )
    made, expected = (
        x.predict(y, derivatives=False)
        for x, y in ((model, theta), (other, other.parameters.start))
    )
    assert structure_names(model) == structure_names(other)
    for own, wanted in zip(
        structure_values(model, made, "side"),
        structure_values(other, expected, "side"),
        strict=True,
    ):
        np.testing.assert_allclose(own, wanted, rtol=1e-6)
    assert structure_values(model, made, "side")[0].max() > 1.0


def test_springs_of_a_meniscus_are_no_structure() -> None:
    model, _ = _reference()
    added = structure_names(model)[len(model.knee.ligaments) :]
    assert added == ("popliteofibular", "posterior_capsule")


def test_contact_is_that_of_the_checks_and_lies_on_its_own_side() -> None:
    model, theta = _reference()
    found = model.predict(theta)
    trial = model.protocol.trials[0]
    side = {}
    for c, name in enumerate(("medial", "lateral")):
        values = [
            quantity_named(model, f"contact.{name}_{x}@{trial}").evaluate(theta)[0]
            for x in ("N", "x_mm", "y_mm", "z_mm")
        ]
        np.testing.assert_array_equal(values, found.centres[0, c, :4])
        side[name] = values[3]
    assert side["medial"] < side["lateral"]
