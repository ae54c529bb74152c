"""Signatures of effects at a fit."""

import numpy as np
from posed_knees import posed_reference
from small_knee import small_protocol

from identknee.diagnosis.base_fit import base_model, fit_from
from identknee.diagnosis.library_signatures import library_variants
from identknee.diagnosis.noise_model import build_noise_model
from identknee.laxity.table import Laxity
from identknee.model.effects.bundles import bundles
from identknee.model.effects.loads import compression
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
    fitted = fit_from(model, laxity, noise, [theta], most_steps=1)
    variants = library_variants(fitted, [bundles(knee), compression()])
    assert [x.signature.name for x in variants] == ["bundles", "compression"]
    # Insertions apart matter by the side of strains apart.
    assert variants[0].is_secant
    moved = [variants[0].effect.parameters.names[i] for i in variants[0].moved]
    assert any(x.endswith("_pct") for x in moved)
    assert any(x.endswith("_mm") for x in moved)
