"""Menisci as a part of the mechanics: their energy, forces, balance and exact derivatives."""

import re
from dataclasses import replace

import numpy as np
import pytest
from energy_evaluation import Evaluator, ligaments_of
from hypothesis import given
from hypothesis import strategies as st
from meniscus_oracle import meniscus_energy
from small_knee import small_knee, small_protocol

import identknee as ik
from identknee.laxity.experiments import Experiment
from identknee.mechanics.contact_points import triangle_areas
from identknee.mechanics.distance_field import ContactLaw
from identknee.mechanics.equilibria import NO_MENISCI
from identknee.model.contact_loads import (
    contact_jacobian,
    contact_values,
    meniscus_jacobian,
    meniscus_values,
)
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel, meniscus_geometry
from identknee.model.missing_wrench import unbalanced_load
from identknee.model.prediction import Prediction
from identknee.model.quantities import quantity_named
from identknee.runs.declare import Array
from identknee.subject.knee import Uncertainty
from identknee.subject.menisci import HIGHEST, MENISCI

VALUES = (0.8, 1.3, 0.1)
EVERYTHING = Uncertainty(
    registration_deg=1.0, registration_mm=1.0, contact_modulus=0.2, flexion_deg=1.0
)
# Central differences of solved poses, relative to the largest slope of a kind.
STEP, SHARE = 1e-5, 1e-6


@pytest.fixture(scope="module")
def small(small_model: LaxityModel) -> LaxityModel:
    """The small knee with menisci whose stiffness and offset vary."""
    return small_model.with_effects([effect_named(small_model.knee, MENISCI)])


def at(model: LaxityModel, values: tuple[float, ...] = VALUES) -> Array:
    """The subject's own parameters, with menisci of these values."""
    theta = np.array(model.parameters.start)
    n = model.n_ligament_parameters
    theta[n : n + 3] = values
    return theta


def _reference(rounding: float, uncertainty: Uncertainty) -> LaxityModel:
    """A knee of a scan with menisci in trials of every kind."""
    knee = replace(ik.example("lenhart2015_stable"), contact_rounding_mm=rounding)
    stiffness = {"medial_stiffness_N_per_mm3": 0.8, "lateral_stiffness_N_per_mm3": 1.3}
    knee = ik.subject.with_menisci(knee, **stiffness)
    (choice,) = knee.effects
    knee = knee.with_effects([replace(choice, fixed=())]).with_uncertainty(uncertainty)
    return LaxityModel(knee=knee, protocol=ik.load_protocol("seed63").select(range(0, 63, 9)))


MODELS = {
    "small": None,
    "scan": (0.0, Uncertainty()),
    "rounded": (0.15, Uncertainty()),
    "uncertain": (0.15, EVERYTHING),
}


def _slopes(model: LaxityModel, found: Prediction) -> list[Array]:
    trials = range(len(found.codes))
    menisci, contact = (f(model, found, trials) for f in (meniscus_jacobian, contact_jacobian))
    assert found.jacobian is not None
    return [found.jacobian, menisci[:, :, 0], menisci[:, :, 1:], contact[:, :, 0]]


def _values(found: Prediction) -> list[Array]:
    menisci, contact = meniscus_values(found), contact_values(found)
    return [found.coordinates, menisci[:, :, 0], menisci[:, :, 1:], contact[:, :, 0]]


@pytest.mark.parametrize("name", MODELS)
def test_slopes_of_poses_and_forces_are_those_of_differences(name: str, small: LaxityModel) -> None:
    made = MODELS[name]
    model = small if made is None else _reference(*made)
    p = model.parameters
    theta = at(model) if made is None else np.array(p.start)
    generator = np.random.default_rng(3)
    theta[: model.n_ligament_parameters] *= 1.0 + 0.02 * generator.uniform(-1.0, 1.0)
    theta += 0.1 * ~p.is_of_interest * p.prior_sd * generator.uniform(-1.0, 1.0, p.n)
    found = model.predict(theta)
    assert found.all_converged
    assert (found.menisci[:, :, 0].max(axis=0) > 1.0).all()
    slopes = _slopes(model, found)
    sds = p.prior_sd_in_own_units
    largest = [np.nanmax(np.abs(x) * sds) for x in slopes]
    for k in range(p.n):
        move = np.zeros(p.n)
        move[k] = STEP * sds[k]
        high, low = (model.predict(theta + s * move, derivatives=False) for s in (1.0, -1.0))
        assert (high.node_poses != low.node_poses).any()
        for own, more, less, size in zip(slopes, _values(high), _values(low), largest, strict=True):
            wanted = (more - less) / (2.0 * STEP)
            error = np.abs(own[..., k] * sds[k] - wanted)
            assert np.nanmax(error) <= SHARE * size, p.names[k]


def test_the_energy_is_the_law_summed_point_by_point(small: LaxityModel) -> None:
    """Against the formula in plain numpy, of poses in which points press, part and are rounded."""
    menisci = meniscus_geometry(small.knee)
    generator = np.random.default_rng(5)
    lines = ligaments_of(small, small.parameters.start)
    for law in (None, ContactLaw(exponent=1.3, rounding=0.1)):
        bare = replace(small.joint, contact=replace(small.joint.contact, law=law))
        pressed = replace(bare.contact, menisci=menisci.at(np.array(VALUES)))
        with_menisci = replace(bare, contact=pressed)
        plain, wedged = Evaluator(bare), Evaluator(with_menisci)
        for _ in range(4):
            pose = small.joint.start + generator.uniform(-1.0, 1.0, 5) * [0.04, 0.04, 0.4, 0.6, 0.4]
            flexion = generator.uniform(-0.1, 0.3)
            low, high = plain(flexion, pose, lines), wedged(flexion, pose, lines)
            wanted, _ = meniscus_energy(menisci, VALUES, flexion, pose)
            assert wanted > 0.0
            assert high.energy - low.energy == pytest.approx(wanted, rel=1e-9)
            for i, step in enumerate((1e-6, 1e-6, 1e-5, 1e-5, 1e-5)):
                move = step * np.eye(5)[i]
                ahead, behind = (
                    meniscus_energy(menisci, VALUES, flexion, pose + s * move)[0]
                    for s in (1.0, -1.0)
                )
                slope = high.gradient[i] - low.gradient[i]
                assert slope == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5, abs=1e-3)


def test_forces_of_both_sides_are_those_of_the_law(small: LaxityModel) -> None:
    found = small.predict(at(small))
    menisci = meniscus_geometry(small.knee)
    flexion = np.radians(small.protocol.flexion_deg)
    forces = meniscus_values(found)[:, :, 0]
    for angle, pose, own in zip(flexion, found.poses, forces, strict=True):
        _, wanted = meniscus_energy(menisci, VALUES, float(angle), pose)
        np.testing.assert_allclose(own, wanted, rtol=1e-6)


def test_ligaments_contact_and_menisci_balance_the_load(small: LaxityModel) -> None:
    found = small.predict(at(small))
    left = unbalanced_load(small, found)
    assert np.abs(left / [40.0, 40.0, 1.0, 1.0, 1.0]).max() < 1e-6
    without = small.with_effects([]).predict(at(small)[: small.n_ligament_parameters])
    assert np.abs(found.coordinates - without.coordinates).max() > 0.01
    # The menisci take over what contact carried, or more.
    assert (contact_values(found)[:, :, 0] < contact_values(without)[:, :, 0]).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_menisci_without_stiffness_change_no_bit(small: LaxityModel, seed: int) -> None:
    plain = small.with_effects([])
    generator = np.random.default_rng(seed)
    theta = at(small, (0.0, 0.0, generator.uniform(0.0, 2.0)))
    n = small.n_ligament_parameters
    theta[:n] *= 1.0 + 0.05 * generator.uniform(-1.0, 1.0, n)
    one, other = small.predict(theta), plain.predict(theta[:n])
    for name in ("coordinates", "poses", "codes", "centres", "hessians"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.jacobian is not None
    np.testing.assert_array_equal(one.jacobian[:, :, :n], other.jacobian)
    assert not one.menisci.any()
    # Their stiffness has slopes all the same, by which a diagnosis finds them.
    assert np.abs(one.jacobian[:, :, n]).max() > 0.0


def test_a_knee_without_menisci_has_no_force_of_theirs(small_model: LaxityModel) -> None:
    found = small_model.predict_once(small_model.parameters.start)
    np.testing.assert_array_equal(meniscus_values(found)[:, :, 0], 0.0)
    assert np.isnan(meniscus_values(found)[:, :, 1:]).all()
    np.testing.assert_array_equal(meniscus_jacobian(small_model, found, [0, 3])[:, :, 0], 0.0)
    assert not len(NO_MENISCI.points)
    with pytest.raises(ValueError, match=r"meniscus\.medial_N.*\[menisci\]"):
        quantity_named(small_model, f"meniscus.medial_N@{small_model.protocol.trials[0]}")


def test_quantities_have_values_and_slopes_of_menisci(small: LaxityModel) -> None:
    theta, trial = at(small), 4
    found = small.predict(theta)
    slopes = meniscus_jacobian(small, found, [trial])[0]
    name = small.protocol.trials[trial]
    for what, unit, (i, j) in (
        ("meniscus.medial_N", "N", (0, 0)),
        ("meniscus.lateral_z_mm", "mm", (1, 3)),
    ):
        quantity = quantity_named(small, f"{what}@{name}")
        value, own = quantity.evaluate(theta)
        assert quantity.unit == unit
        assert value == quantity.value(found) == meniscus_values(found)[trial, i, j]
        np.testing.assert_array_equal(own, slopes[i, j])
    for wrong in ("meniscus.middle_N", "meniscus.medial_kN"):
        with pytest.raises(ValueError, match=re.escape(repr(wrong))):
            quantity_named(small, f"{wrong}@{name}")


def test_wedges_lie_around_the_plateaus_as_high_as_the_gaps() -> None:
    """About half of each plateau, open to the inside, on all other sides."""
    knee = ik.example("lenhart2015")
    menisci = meniscus_geometry(knee)
    assert 150 <= len(menisci.points) <= 250
    assert (menisci.heights <= HIGHEST + 0.1).all()
    assert menisci.heights.min() > -0.1
    for c, (surface, inward) in enumerate(zip(knee.tibia, (1.0, -1.0), strict=True)):
        own = menisci.side == c
        whole = triangle_areas(surface.vertices, surface.faces).sum()
        assert 0.3 < menisci.areas[own].sum() / whole < 0.7
        forward, _, across = (menisci.points[own] - knee.tibia_frame.to_local(surface.centroid)).T
        assert (forward > 8.0).any()
        assert (forward < -8.0).any()
        assert (inward * across < -8.0).any()
        # Nothing between the plateaus.
        assert not ((inward * across > 6.0) & (np.abs(forward) < 6.0)).any()


@pytest.mark.slow
def test_more_points_change_the_prediction_little(monkeypatch: pytest.MonkeyPatch) -> None:
    knee = ik.subject.with_menisci(ik.example("lenhart2015_stable"))
    model = LaxityModel(knee=knee, protocol=ik.load_protocol("seed63").select(range(0, 63, 9)))
    usual = model.predict(model.parameters.start, derivatives=False).coordinates
    monkeypatch.setattr(
        "identknee.model.laxity_model.meniscus_geometry",
        lambda own: meniscus_geometry(own, 1000),
    )
    many = model.predict(model.parameters.start, derivatives=False).coordinates
    assert 0.0 < np.sqrt(np.mean((usual - many) ** 2, axis=0)).max() < 0.05


def test_menisci_act_in_every_state_of_a_knee() -> None:
    knee = ik.subject.with_menisci(small_knee())
    protocol = replace(
        small_protocol(),
        state=("intact",) * 3 + ("cut: front",) * 3,
        experiments=(Experiment(name="all", rig="rig", mounting="mounting"),),
    )
    model = LaxityModel(knee=knee, protocol=protocol)
    found = model.predict(np.array(model.parameters.start))
    assert found.all_converged
    slopes = meniscus_jacobian(model, found, range(6))[:, :, 0]
    for part in model.parts:
        own = part.prediction(found)
        np.testing.assert_array_equal(found.menisci[part.trials], own.menisci)
        of_part = meniscus_jacobian(part.model, own, range(3))[:, :, 0]
        np.testing.assert_array_equal(slopes[part.trials][..., part.columns], of_part)
    assert np.abs(slopes).max() > 0.0
    assert np.abs(unbalanced_load(model, found)[:, 2:]).max() < 1e-6
