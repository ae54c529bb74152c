"""Signatures of effects at a fit."""

import numpy as np
import pytest
from posed_knees import posed_reference
from small_knee import small_protocol

from identknee.diagnosis.candidates import _signs, library_variants
from identknee.diagnosis.fitting import FittedModel, base_model, best_fit_from
from identknee.diagnosis.noise_model import build_noise_model
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity
from identknee.model.effects.effect import amplitudes
from identknee.model.effects.library import effect_named
from identknee.model.effects.loads import compression
from identknee.model.effects.tissues import bundles
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Knee
from identknee.subject.ligament import Ligament

SD = 0.3


def test_a_knee_of_many_ligaments_has_a_signature_of_its_bundles() -> None:
    knee = posed_reference()
    first = knee.ligaments[0]
    more = [
        Ligament(
            name=f"strand{i}",
            femur=first.femur + np.array([0.0, 0.0, float(i)]),
            tibia=first.tibia,
            stiffness_kN=0.1,
            reference_strain_pct=2.0,
        )
        for i in range(3)
    ]
    knee = knee.with_ligaments([*knee.ligaments, *more])
    model = base_model(knee, small_protocol())
    theta = model.parameters.center
    exact = model.predict(theta, derivatives=False)
    laxity = Laxity(
        protocol=model.protocol,
        coordinates=exact.coordinates,
        sd=np.full(exact.coordinates.shape, SD),
    )
    noise = build_noise_model(np.full((laxity.n, 5), SD), laxity.is_measured, correlation=0.0)
    fitted = best_fit_from(model, laxity, noise, [theta], most_steps=1)
    variants = library_variants(fitted, [bundles(knee), compression()])
    assert [x.signature.name for x in variants] == ["bundles", "compression"]
    # Insertions apart matter by the side of strains apart.
    assert variants[0].is_secant
    moved = [variants[0].effect.parameters.names[i] for i in variants[0].moved]
    assert any(x.endswith("_pct") for x in moved)
    assert any(x.endswith("_mm") for x in moved)


@pytest.fixture(scope="module")
def fitted(reference: Knee) -> FittedModel:
    """The reference knee at its own laxity, so that derivatives are all there is to see."""
    trials = load_protocol("seed63").select(np.arange(1, 63, 6))
    model = LaxityModel(knee=reference, protocol=trials)
    theta = model.parameters.center
    laxity = model.simulate(theta)
    noise = build_noise_model(np.full((laxity.n, 5), SD), laxity.is_measured, correlation=0.3)
    return best_fit_from(model, laxity, noise, [theta])


def test_amplitudes_of_one_sign_are_those_that_cannot_be_negative(fitted: FittedModel) -> None:
    """A structure cannot push, a rig cannot yield backwards; a moment can be either."""
    names = ("deep_mcl", "rig_compliance_IE", "meniscus", "moment_offset", "compression")
    effects = [effect_named(fitted.model.knee, x) for x in names]
    signs = {x.signature.name: set(x.signature.sign) for x in library_variants(fitted, effects)}
    assert signs == {
        "deep_mcl": {1},
        "rig_compliance_IE": {1},
        "meniscus": {1},
        "moment_offset": {0},
        "compression": {0},
    }


def test_effects_at_rest_have_the_signatures_that_each_has_alone(fitted: FittedModel) -> None:
    """They share one prediction, in which lines are split, moved and added."""
    names = ("bundles", "insertion", "posterior_capsule", "meniscus", "toe_strain", "tibia_frame")
    effects = [effect_named(fitted.model.knee, x) for x in names]
    together = library_variants(fitted, effects)
    alone = [x for effect in effects for x in library_variants(fitted, [effect])]
    assert [x.signature.name for x in together] == [x.signature.name for x in alone]
    for one, other in zip(together, alone, strict=True):
        columns = other.signature.columns
        close = 1e-6 * np.abs(columns).max()
        np.testing.assert_allclose(one.signature.columns, columns, rtol=0.0, atol=close)


def test_amplitudes_that_cannot_be_positive_have_the_other_sign() -> None:
    made = amplitudes(
        "less", ["a_mm", "b_mm", "c_mm"], [1.0] * 3, lower=[-2, 0, -2], upper=[0, 2, 2]
    )
    assert _signs(made).tolist() == [-1, 1, 0]


@pytest.mark.parametrize("name", ["deep_mcl", "anterolateral", "moment_gain_IE", "compression"])
def test_a_signature_is_what_the_effect_does_to_the_predictions(
    name: str, fitted: FittedModel
) -> None:
    """By a small amplitude of the effect, predicted anew: direction, sign and size."""
    effect = effect_named(fitted.model.knee, name)
    extended = fitted.model.with_effects([effect])
    compared = 0
    for variant in library_variants(fitted, [effect]):
        small = np.array(variant.values)
        size = 1e-4 * effect.parameters.prior_sd[variant.moved[0]]
        small[variant.moved[0]] += size
        moved, still = (
            extended.predict(np.r_[fitted.theta, x], derivatives=False).coordinates
            for x in (small, variant.values)
        )
        change = fitted.columns(((moved - still) / size)[:, :, None])[:, 0]
        column = variant.signature.columns[:, 0]
        # Lines that are slack at the fit do nothing until they are not.
        assert np.abs(change - column).max() <= 5e-3 * np.abs(column).max()
        compared += 1
        if compared == 4:
            break
    assert compared
