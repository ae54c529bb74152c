"""A knee with what a result found of it predicts what the result predicted."""

from pathlib import Path

import numpy as np
import pytest

import identknee as ik
from identknee.subject.knee import EffectChoice
from identknee.verbs.fitted_knee import fitted_knee, knee_as_fitted

SAME = 1e-9  # mm and deg; the same simulation of the same numbers


def test_a_fitted_knee_predicts_the_fit_with_its_insertions_moved() -> None:
    knee = ik.example("reference")
    data = ik.simulate(knee, "drawer", noise="0.3mm,0.3deg", seed=1).noisy
    assert data is not None
    fit = ik.fit(knee, data, start="IG4", uncertain="insertions=2mm", priors=True, budget=40)
    found = fitted_knee(knee, fit)
    assert np.linalg.norm(found.ligament("ACL").tibia - knee.ligament("ACL").tibia) > 0.05
    again = ik.simulate(found, fit.protocol)
    np.testing.assert_allclose(again.coordinates, fit.coordinates, atol=SAME)
    # What was not fitted stays, and so does the knee itself.
    assert found.uncertainty == knee.uncertainty
    assert knee.ligament("ACL").stiffness_kN == 10.0


def test_the_folder_that_a_fit_leaves_is_the_fitted_knee(tmp_path: Path) -> None:
    knee = ik.example("reference")
    data = ik.simulate(knee, "drawer", {"ACL.stiffness_kN": 8.0}).laxity
    fit = ik.fit(knee, data, uncertain="insertions=2mm", priors=True, budget=20, out=tmp_path)
    left, wanted = knee_as_fitted(ik.read_subject(tmp_path / "fitted")), fitted_knee(knee, fit)
    assert not left.effects
    for one, other in zip(left.ligaments, wanted.ligaments, strict=True):
        assert one.stiffness_kN == pytest.approx(other.stiffness_kN, rel=1e-12)
        assert one.reference_strain_pct == pytest.approx(other.reference_strain_pct, rel=1e-9)
        np.testing.assert_allclose(one.femur, other.femur, atol=SAME)
        np.testing.assert_allclose(one.tibia, other.tibia, atol=SAME)
    assert knee_as_fitted(knee) is knee


def test_an_effect_of_the_knee_gets_its_amplitude() -> None:
    compression = EffectChoice(name="compression", values={"force_N": 20.0})
    knee = ik.example("reference").with_effects([compression])
    simulated = ik.simulate(knee, "drawer", {"compression.force_N": 35.0, "ACL.stiffness_kN": 7.0})
    found = fitted_knee(knee, simulated)
    assert found.effects[0].values == {"force_N": 35.0}
    assert found.ligament("ACL").stiffness_kN == 7.0


def test_results_of_another_knee_or_without_parameters_are_refused() -> None:
    knee = ik.example("reference")
    simulated = ik.simulate(knee, "drawer")
    softer = fitted_knee(knee, ik.simulate(knee, "drawer", {"ACL.stiffness_kN": 7.0}))
    with pytest.raises(ValueError, match="not of reference as it is now"):
        fitted_knee(softer, simulated)
    with pytest.raises(ValueError, match="holds no parameter set"):
        fitted_knee(knee, ik.information(knee, simulated.laxity, noise="0.3mm,0.3deg"))
