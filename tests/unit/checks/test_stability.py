"""How well posed a subject is, in numbers and sentences."""

import numpy as np
import pytest

from identknee.checks.subject_checks import StabilityReport, box_sample, check_stability
from identknee.laxity.protocol import load_protocol
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import ligament_parameters
from identknee.runs.executors import threads
from identknee.runs.findings import Severity
from identknee.runs.record import Outcome
from identknee.subject.reference import reference_knee

N_SAMPLES = 20


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    return LaxityModel(knee=reference_knee(), protocol=load_protocol("seed63"))


@pytest.fixture(scope="module")
def report(model: LaxityModel) -> StabilityReport:
    return check_stability(model, n_samples=N_SAMPLES, seed=1)


def test_the_reference_knee_is_stable(report: StabilityReport) -> None:
    assert report.n_converged == 63
    assert report.lowest_margin > 0.5
    assert report.findings[0].severity is Severity.INFO
    assert report.findings[0].code == "all-converge"
    assert report.findings[0].values["n"] == 63


def test_the_box_is_counted(report: StabilityReport) -> None:
    assert sum(report.box_outcomes.values()) == 63 * N_SAMPLES
    converged = report.box_outcomes[Outcome.CONVERGED]
    assert report.converged_share == converged / (63 * N_SAMPLES)
    assert report.box_margins.shape == (N_SAMPLES,)


def test_threads_and_seeds_repeat(model: LaxityModel, report: StabilityReport) -> None:
    with threads(2) as executor:
        again = check_stability(model, n_samples=N_SAMPLES, seed=1, executor=executor)
    np.testing.assert_array_equal(again.box_margins, report.box_margins)
    assert again.box_outcomes == report.box_outcomes


def test_fewer_contact_points_are_compared_with_all() -> None:
    protocol = load_protocol("seed63").select([0, 30, 40])
    coarse = LaxityModel(knee=reference_knee(), protocol=protocol, n_points=150)
    report = check_stability(coarse, n_samples=0)
    assert report.change_mm > 0.0
    assert report.change_deg > 0.0
    assert np.isnan(report.converged_share)
    finding = report.findings[-1]
    assert finding.where == "contact points"
    assert finding.values["change_mm"] == report.change_mm
    assert finding.values["change_deg"] == report.change_deg
    assert (finding.severity is Severity.WARNING) == bool(finding.remedy)


def test_a_knee_without_ligament_forces_is_an_error() -> None:
    knee = reference_knee()
    slack = [
        type(x)(
            name=x.name,
            femur=x.femur,
            tibia=x.tibia,
            stiffness_kN=0.0,
            reference_strain_pct=x.reference_strain_pct,
        )
        for x in knee.ligaments
    ]
    model = LaxityModel(
        knee=knee.with_ligaments(slack), protocol=load_protocol("seed63").select([0, 1])
    )
    report = check_stability(model, n_samples=0)
    assert report.n_converged == 0
    assert np.isnan(report.lowest_margin)
    first, last = report.findings
    assert (first.code, first.severity) == ("trials-not-converging", Severity.ERROR)
    assert (first.values["n_lost"], first.values["n"]) == (2, 2)
    assert first.values["trials"] == ["flexion0_varus-10Nm", "flexion0_varus-8Nm"]
    assert "No single insertion moved by 3 mm restores a trial" in first.remedy
    assert len(report.moves) == 4 * 2 * 6
    assert (last.code, last.severity) == ("contact-points-coarse", Severity.WARNING)


def test_every_finding_that_is_no_info_has_a_remedy(report: StabilityReport) -> None:
    for finding in report.findings:
        assert bool(finding.remedy) == (finding.severity is not Severity.INFO)


def test_the_box_stays_within_the_bounds() -> None:
    parameters = ligament_parameters(["A", "B"], [30.0, 10.0], [14.0, 0.0])
    drawn = box_sample(parameters, 500, np.random.default_rng(0))
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    # Within 2 % of the box's width of its ends after 500 draws.
    np.testing.assert_allclose(low, [15.0, 5.0, 11.0, -3.0], atol=0.5)
    np.testing.assert_allclose(high, [40.0, 15.0, 15.0, 3.0], atol=0.5)
    assert (drawn <= parameters.upper).all()


def test_amplitudes_of_effects_vary_over_their_own_plausible_ranges() -> None:
    frame = effect_named(reference_knee(), "femur_frame")
    extended = LaxityModel(
        knee=reference_knee(), protocol=load_protocol("seed63"), effects=(frame,)
    ).parameters
    drawn = box_sample(extended, 500, np.random.default_rng(0))
    own = slice(-frame.parameters.n, None)
    width = extended.upper[own] - extended.lower[own]
    # All but 2 % of the range is reached by 500 draws; 3 of anything would be another share.
    assert (np.ptp(drawn[:, own], axis=0) > 0.98 * width).all()
    assert (drawn >= extended.lower).all()


def test_a_negative_number_of_samples_is_refused(model: LaxityModel) -> None:
    with pytest.raises(ValueError, match="number of samples must be 0 or more, got -1"):
        check_stability(model, n_samples=-1)


def test_values_beyond_the_bounds_leave_the_nearest_bound() -> None:
    parameters = ligament_parameters(["ACL", "PCL"], [10.0, 500.0], [-40.0, 17.0])
    drawn = box_sample(parameters, 50, np.random.default_rng(0))
    stiff, soft, slack, taut = drawn[:, 1], drawn[:, 0], drawn[:, 2], drawn[:, 3]
    assert (stiff == 40.0).all()
    assert ((soft >= 5.0) & (soft <= 15.0)).all()
    assert (slack == -15.0).all()
    assert ((taut >= 14.0) & (taut <= 15.0)).all()
