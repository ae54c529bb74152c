"""Menisci that a knee has and its model lacks are named, with their stiffness."""

import numpy as np
import pytest

import identknee as ik
from identknee.diagnosis.investigation import investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.subject.menisci import MENISCI

STIFFNESS = {"medial_stiffness_N_per_mm3": 0.7, "lateral_stiffness_N_per_mm3": 1.3}
FEW = (MENISCI, "meniscus", "deep_mcl", "cartilage", "compression", "tibia_frame")


def laxity_of(knee: ik.Knee) -> Laxity:
    """What the knee does with menisci and other ligaments than its own, with noise."""
    true = ik.subject.with_menisci(knee, **STIFFNESS)
    model = LaxityModel(knee=true, protocol=ik.load_protocol("seed63"))
    theta = np.array(model.parameters.start)
    theta[:8] *= 1.0 + 0.1 * np.random.default_rng(4).uniform(-1.0, 1.0, 8)
    return add_noise(model.simulate(theta), sd_mm=0.3, sd_deg=0.3, seed=7)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reference", "lenhart2015_stable"])
def test_hidden_menisci_are_named_among_all_causes(name: str) -> None:
    knee = ik.example(name)
    found = investigate(knee, laxity_of(knee))
    assert found is not None
    assert found.conclusion.verdict is Verdict.NAMED
    assert found.explanation.names == (MENISCI,)
    (choice,) = [x for x in found.extended_knee.effects if x.name == MENISCI]
    for side, value in STIFFNESS.items():
        assert choice.values[side] == pytest.approx(value, rel=0.3)


@pytest.mark.slow
def test_a_knee_without_them_has_no_menisci() -> None:
    knee = ik.reference_knee()
    model = LaxityModel(knee=knee, protocol=ik.load_protocol("seed63"))
    laxity = add_noise(model.simulate(model.parameters.start), sd_mm=0.3, sd_deg=0.3, seed=3)
    found = investigate(knee, laxity, effects=[effect_named(knee, x) for x in FEW])
    assert found is not None
    assert found.conclusion.verdict is Verdict.ADEQUATE


@pytest.mark.slow
def test_a_fit_finds_the_stiffness_of_menisci_that_a_knee_has() -> None:
    knee = ik.subject.with_menisci(ik.example("lenhart2015_stable"))
    protocol = ik.load_protocol("seed63").select(range(0, 63, 4))
    model = LaxityModel(knee=knee, protocol=protocol)
    theta = np.array(model.parameters.start)
    theta[8:] = STIFFNESS["medial_stiffness_N_per_mm3"], STIFFNESS["lateral_stiffness_N_per_mm3"]
    laxity = add_noise(model.simulate(theta), sd_mm=0.1, sd_deg=0.1, seed=1)
    fitted = ik.fit(knee, laxity).parameter_set
    for side, value in STIFFNESS.items():
        assert fitted[f"{MENISCI}.{side}"] == pytest.approx(value, rel=0.35)
