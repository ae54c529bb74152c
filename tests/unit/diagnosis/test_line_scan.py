"""Candidate lines, what they would do, and how the scan finds one of them."""

from dataclasses import replace

import numpy as np
import pytest
from posed_knees import posed_reference

from identknee.diagnosis.fitting import FittedModel, best_fit_from
from identknee.diagnosis.missing_line import (
    LENGTHS,
    MOST_LINES,
    NAME,
    SLACK_STRAINS,
    CandidateLines,
    LineScan,
    candidate_lines,
    line_columns,
    scan_lines,
)
from identknee.diagnosis.noise_model import build_noise_model
from identknee.laxity.protocol import load_protocol
from identknee.model.effects.structures import structure_at
from identknee.model.effects.tissues import Cartilage
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array
from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee

STIFFNESS = 1e-4  # kN
# Of the largest change: the next order of the stiffness, and the solver's tolerance over it.
FIRST_ORDER = 2e-3
# Standard errors; a right test exceeds it once in a million.
SIGMAS = 5.0


@pytest.fixture(scope="module")
def model(reference: Knee) -> LaxityModel:
    trials = load_protocol("seed63").select(np.arange(0, 63, 4))
    return LaxityModel(knee=reference, protocol=trials, effects=(Cartilage(),))


@pytest.fixture(scope="module")
def fitted(model: LaxityModel) -> FittedModel:
    """The model at its own parameters and its own laxity."""
    theta = model.parameters.center
    laxity = model.simulate(theta)
    noise = build_noise_model(np.full((laxity.n, 5), 0.3), laxity.is_measured, correlation=0.3)
    return best_fit_from(model, laxity, noise, [theta])


def with_data(fitted: FittedModel, coordinates: Array) -> FittedModel:
    return replace(fitted, laxity=replace(fitted.laxity, coordinates=coordinates))


@pytest.fixture(scope="module")
def lines(reference: Knee) -> CandidateLines:
    every = candidate_lines(reference)
    return CandidateLines(femur=every.femur[::10], tibia=every.tibia[::10])


@pytest.mark.parametrize("knee", [reference_knee(), posed_reference(3)], ids=["plain", "posed"])
def test_candidates_are_short_and_on_one_side(knee: Knee) -> None:
    found = candidate_lines(knee)
    assert found.n == MOST_LINES
    length = np.linalg.norm(found.femur - found.tibia, axis=1)
    assert (length > LENGTHS[0]).all()
    assert (length < LENGTHS[1]).all()
    across = np.stack(
        [knee.femur_frame.to_local(found.femur)[:, 2], knee.tibia_frame.to_local(found.tibia)[:, 2]]
    )
    far = np.abs(across).min(axis=0) > 25.0
    assert (np.sign(across[0, far]) == np.sign(across[1, far])).all()


def test_a_line_slid_along_itself_is_close() -> None:
    femur = np.array([[0.0, 30.0, 0.0], [0.0, 50.0, 0.0], [0.0, 30.0, 13.0], [9.0, 30.0, 0.0]])
    tibia = np.array([[0.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, 0.0, 0.0], [-9.0, 0.0, 0.0]])
    lines = CandidateLines(femur=femur, tibia=tibia)
    assert lines.close_to(0, 12.0).tolist() == [True, True, False, True]


@pytest.mark.parametrize("line", [0, 3, 7])
def test_columns_are_what_a_weak_structure_does(
    line: int, model: LaxityModel, reference: Knee
) -> None:
    every = candidate_lines(reference)
    chosen = CandidateLines(femur=every.femur[50 * line :][:1], tibia=every.tibia[50 * line :][:1])
    theta = model.parameters.vector({"cartilage.exponent": 0.2})
    columns = line_columns(model, model.predict(theta), chosen)[:, :, :, 0]
    hidden = structure_at(
        reference,
        "hidden",
        [(chosen.femur[0], chosen.tibia[0])],
        stiffness_sd=1.0,
        sites_vary=False,
    )
    extended = model.with_effects((*model.effects, hidden))
    for k, strain in enumerate(SLACK_STRAINS):
        changed, unchanged = (
            extended.predict(np.r_[theta, x, strain]).coordinates for x in (STIFFNESS, 0.0)
        )
        found = (changed - unchanged) / STIFFNESS
        scale = max(float(np.abs(found).max()), 1.0)
        np.testing.assert_allclose(columns[:, :, k], found, atol=FIRST_ORDER * scale)


def best_seen(scan: LineScan, k: int) -> int:
    """The line of which most is left, at the slack strain of that number."""
    return int(np.argmax(np.linalg.norm(scan.signatures[:, k], axis=0)))


def with_effect_of(
    fitted: FittedModel, lines: CandidateLines, line: int, k: int, size: float
) -> FittedModel:
    """The model with data that a line changed, to first order."""
    model = fitted.model
    columns = line_columns(model, model.predict_once(fitted.theta), lines)
    return with_data(fitted, fitted.laxity.coordinates + size * columns[:, :, k, line])


def test_the_scan_finds_the_line_that_pulls(fitted: FittedModel, lines: CandidateLines) -> None:
    theta = fitted.theta
    blank = scan_lines(fitted, theta, lines)
    assert blank is not None
    assert blank.scores.max() < 1e-6
    k = 2
    line = best_seen(blank, k)
    scan = scan_lines(with_effect_of(fitted, lines, line, k, 0.3), theta, lines)
    assert scan is not None
    best = scan.best(3)
    np.testing.assert_array_equal(best[0].femur, lines.femur[line])
    assert best[0].strain_pct == SLACK_STRAINS[k]
    assert best[0].amplitude == pytest.approx(0.3, rel=0.05)
    assert [x.score for x in best] == sorted((x.score for x in best), reverse=True)
    assert scan.p_value(0) == pytest.approx(1.0 / 1001.0)


def test_a_line_that_would_push_scores_nothing(fitted: FittedModel, lines: CandidateLines) -> None:
    theta = fitted.theta
    scan = scan_lines(with_effect_of(fitted, lines, 5, 2, -0.3), theta, lines)
    assert scan is not None
    assert scan.scores[2, 5] == 0.0
    assert scan.amplitudes[2, 5] == 0.0


def test_what_parameters_explain_scores_nothing(fitted: FittedModel, lines: CandidateLines) -> None:
    theta = fitted.theta
    jacobian = fitted.model.predict_once(theta).jacobian
    assert jacobian is not None
    shift = np.zeros(len(theta))
    shift[0] = 0.5
    change = jacobian @ shift
    scan = scan_lines(with_data(fitted, fitted.laxity.coordinates + change), theta, lines)
    assert scan is not None
    # The prior holds the parameter back a little, in the direction of the shift.
    assert scan.scores.max() < 0.2 * np.linalg.norm(fitted.columns(change[:, :, None]))


def test_a_line_in_the_model_is_taken_out(
    fitted: FittedModel, lines: CandidateLines, reference: Knee
) -> None:
    k = 2
    blank = scan_lines(fitted, fitted.theta, lines)
    assert blank is not None
    line = best_seen(blank, k)
    own = structure_at(reference, NAME, [(lines.femur[line], lines.tibia[line])], stiffness_sd=1.5)
    extended = fitted.model.with_effects((*fitted.model.effects, own))
    theta = np.r_[fitted.theta, 0.05, SLACK_STRAINS[k], np.zeros(6)]
    exact = replace(fitted, model=extended, laxity=extended.simulate(theta))
    scan = scan_lines(exact, theta, lines)
    assert scan is not None
    # Of all lines it explains most itself, though the model with it leaves nothing.
    assert scan.scores[k, line] == pytest.approx(scan.scores.max(), rel=0.02)
    assert scan.scores[k, line] > 1.0
    assert scan.amplitudes[k, line] == pytest.approx(0.05, rel=0.1)


def test_where_the_model_has_no_prediction_there_is_no_scan(
    fitted: FittedModel, lines: CandidateLines
) -> None:
    theta = np.array(fitted.theta)
    theta[: len(fitted.model.knee.ligaments)] = 0.0
    assert scan_lines(fitted, theta, lines) is None


def test_p_values_of_noise_are_uniform() -> None:
    generator = np.random.default_rng(4)
    rows, m, n = 30, 40, 60
    signatures: Array = generator.standard_normal((rows, len(SLACK_STRAINS), m))
    signatures /= np.linalg.norm(signatures, axis=0)
    places = generator.uniform(0.0, 50.0, (2, m, 3))
    p_values = []
    for i in range(n):
        scores = np.maximum(np.einsum("r,rsm->sm", generator.standard_normal(rows), signatures), 0)
        scan = LineScan(
            lines=CandidateLines(femur=places[0], tibia=places[1]),
            scores=scores,
            amplitudes=scores,
            signatures=signatures,
        )
        p_values.append(scan.p_value(i))
    assert np.mean(p_values) == pytest.approx(0.5, abs=SIGMAS / np.sqrt(12 * n))
    assert np.mean(np.array(p_values) < 0.2) == pytest.approx(0.2, abs=SIGMAS * np.sqrt(0.16 / n))
