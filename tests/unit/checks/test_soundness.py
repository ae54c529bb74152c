"""Every later result says that its subject folds, or that contact comes near a rim."""

import pytest
from knees import model as named_model
from narrow_knee import narrow_knee

from identknee.checks import subject_checks
from identknee.checks.subject_checks import rim_findings, stability_findings
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.runs.findings import Severity


def test_a_stable_subject_is_not_mentioned() -> None:
    assert stability_findings(named_model("reference")) == ()


def test_a_subject_that_folds_is_named_with_its_trials() -> None:
    (finding,) = stability_findings(named_model("lenhart2015"))
    assert (finding.code, finding.severity) == ("unstable-subject", Severity.WARNING)
    assert (finding.values["n_lost"], finding.values["n"]) == (11, 63)
    assert "(11 at a fold;" in finding.sentence


def test_a_subject_hardly_stable_is_named_with_its_weakest_trial(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reference = named_model("reference")
    found = reference.predict(reference.parameters.start)
    lowest = float(found.margins.min())
    weakest = reference.protocol.trials[int(found.margins.argmin())]
    monkeypatch.setattr(subject_checks, "ENOUGH_MARGIN", 1.01 * lowest)
    (finding,) = stability_findings(reference)
    assert finding.code == "hardly-stable-subject"
    assert finding.values["margin_N_per_mm"] == pytest.approx(lowest)
    assert finding.values["trial"] == weakest


def test_contact_near_a_rim_is_named_with_its_share() -> None:
    model = LaxityModel(knee=narrow_knee(0.8), protocol=load_protocol("seed63"))
    prediction = model.predict(model.parameters.center, derivatives=False)
    (finding,) = rim_findings(model.protocol.trials, prediction)
    assert (finding.code, finding.severity) == ("contact-near-rim", Severity.INFO)
    assert finding.values["n"] == 5
    assert rim_findings((), named_model("reference").predict(model.parameters.center)) == ()
