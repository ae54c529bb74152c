"""Diagnosis of a knee that states how well its insertions are known."""

from functools import cache

import numpy as np
import pytest
from diagnoses import SD, short_trials

from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.table import Laxity, add_noise
from identknee.model.effects.loads import compression
from identknee.model.effects.readings import tibia_frame
from identknee.model.laxity_model import LaxityModel
from identknee.subject.knee import Uncertainty
from identknee.subject.reference import reference_knee

TWO_MM = Uncertainty(insertions_mm=2.0)


def misplaced(size: float) -> Laxity:
    """Laxity of the reference knee with insertions off by `size` standard deviations of 2 mm."""
    model = LaxityModel(knee=reference_knee().with_uncertainty(TWO_MM), protocol=short_trials())
    p = model.parameters
    drawn = np.random.default_rng(5).standard_normal(p.n) * ~p.is_of_interest
    made = model.simulate(p.start + size * p.prior_sd * drawn)
    return add_noise(made, sd_mm=SD, sd_deg=SD, seed=1)


@cache
def diagnosed(stated: Uncertainty) -> Investigation:
    # Two candidates are enough for what is asked here, and quick.
    candidates = (tibia_frame(), compression())
    knee = reference_knee().with_uncertainty(stated)
    found = investigate(knee, misplaced(0.8), effects=candidates)
    assert found is not None
    return found


def test_an_error_of_the_stated_size_is_no_finding() -> None:
    found = diagnosed(TWO_MM)
    assert found.conclusion.verdict is Verdict.ADEQUATE
    assert found.base.fitted.nuisance_findings == ()
    assert found.base.fitted.nuisances[0].name.startswith("insertion.")


@pytest.mark.slow
def test_the_same_data_speak_against_a_knee_that_is_said_to_be_exact() -> None:
    assert diagnosed(Uncertainty()).conclusion.verdict is not Verdict.ADEQUATE


def test_an_error_beyond_what_is_stated_names_the_ligament() -> None:
    (finding, *_) = diagnosed(Uncertainty(insertions_mm=0.2)).base.fitted.nuisance_findings
    assert finding.where.startswith("insertion.")
    assert finding.code == "nuisance-beyond-prior"
    assert "identknee diagnose" not in finding.sentence


@pytest.mark.slow
def test_what_is_stated_to_be_uncertain_is_no_candidate() -> None:
    assert "insertion" not in {x.name for x in diagnosed(TWO_MM).exclusions}
    assert "insertion" in {x.name for x in diagnosed(Uncertainty()).exclusions}
