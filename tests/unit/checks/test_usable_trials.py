"""Fits to tables of which the model loses trials at the start."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_knee import as_read, small_knee

import identknee as ik
from identknee.checks.usable_trials import (
    TrialSearch,
    knee_with_equilibria,
    starts_by_stretch,
    starts_elsewhere,
)
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.table import Laxity, write_laxity
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.model.mechanics_inputs import strains_as_measured
from identknee.runs.findings import Severity
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Knee, Uncertainty
from identknee.verbs.answer import IN_WORDS

pytestmark = pytest.mark.usefixtures("few_starts")


def slack() -> Knee:
    """The same knee, its ligaments as slack as a subject's placeholders may make them."""
    knee = small_knee()
    slack = tuple(replace(x, reference_strain_pct=-30.0) for x in knee.ligaments)
    return replace(knee, ligaments=slack)


def displaced(laxity: Laxity) -> Laxity:
    """The same table with a trial so far apart that no parameters take the tibia there."""
    coordinates = np.array(laxity.coordinates)
    coordinates[2] += [0.0, 0.0, 60.0, 0.0, 0.0]
    return replace(laxity, coordinates=coordinates)


def test_a_fit_from_slack_ligaments_regains_all_trials() -> None:
    laxity = as_read()
    model = LaxityModel(knee=slack(), protocol=laxity.protocol).with_tests(laxity)
    lost = ~model.predict(model.parameters.start).is_converged
    assert lost.sum() > laxity.n / 2
    found = ik.fit(slack(), laxity)
    assert found.trials_used == laxity.protocol.trials
    assert not found.trials_without_equilibrium
    assert found.rmse.mm < 1e-6
    assert found.rmse.n_compared == laxity.is_measured.sum()
    said = " ".join(found.assumptions)
    assert "measured pose" in said
    assert f"{lost.sum()} of {laxity.n} measured trials" in said
    assert found.start_parameters["front"]["reference_strain_pct"] == -30.0


@pytest.mark.usefixtures("no_conventions")
def test_a_trial_that_cannot_be_reached_is_left_out_and_named() -> None:
    laxity = displaced(as_read())
    name = laxity.protocol.trials[2]
    found = ik.fit(small_knee(), laxity)
    assert found.trials_used == tuple(x for x in laxity.protocol.trials if x != name)
    assert [x.trial for x in found.trials_without_equilibrium] == [name]
    assert found.rmse.n_compared == laxity.is_measured.sum() - 5
    (finding,) = [x for x in found.findings if x.code == "trials-lost"]
    assert (finding.code, finding.severity) == ("trials-lost", Severity.WARNING)
    assert finding.values["n_used"] == finding.values["n_measured"] - 1 == laxity.n - 1
    assert finding.values["trials"] == [name]
    assert found.rmse.mm < 1e-6


def test_the_problem_is_defined_everywhere_with_exact_derivatives() -> None:
    """A trial without equilibrium has residuals, and costs more than any that has one."""
    search = _search(as_read(), slack())
    problem, start = search.problem_everywhere(search.laxity), search.model.parameters.start
    residuals, jacobian = problem.residuals(start), problem.jacobian(start)
    n = int(search.laxity.is_measured.sum())
    lacking = residuals[n:]
    np.testing.assert_array_equal(lacking > 0.0, ~search.has_equilibrium(start))
    assert lacking[lacking > 0.0].min() > np.abs(residuals[:n]).max()
    for i in range(start.size):
        step = np.zeros(start.size)
        step[i] = 1e-5
        ends = [problem.residuals(start + sign * step) for sign in (-1.0, 1.0)]
        change = (ends[1] - ends[0]) / 2e-5
        np.testing.assert_allclose(change, jacobian[:, i], atol=1e-6 * np.abs(jacobian).max())


def test_where_all_trials_have_an_equilibrium_nothing_is_added() -> None:
    search = _search(as_read())
    start = search.model.parameters.start
    plain = search.problem(search.laxity).residuals(start)
    everywhere = search.problem_everywhere(search.laxity).residuals(start)
    np.testing.assert_array_equal(everywhere[: plain.size], plain)
    np.testing.assert_array_equal(everywhere[plain.size :], 0.0)


def test_starts_by_stretch_stretch_each_ligament_by_minus_3_to_10_percent() -> None:
    laxity = as_read()
    model = LaxityModel(knee=small_knee(), protocol=laxity.protocol).with_tests(laxity)
    start, u = model.parameters.start, model.tied.n
    starts = starts_by_stretch(model, start, 16)
    slack = strains_as_measured(model.setting(start), 0.0)
    stretch = starts[:, u : 2 * u] - slack
    assert stretch.min() >= -3.0 - 1e-9
    assert stretch.max() <= 10.0 + 1e-9
    assert np.ptp(stretch, axis=0).min() > 8.0
    assert starts[:, :u].min() >= 1.0
    # Evenly in the logarithm: half of them below the geometric mean of 1 and 40 kN.
    below = (starts[:, :u] < np.sqrt(40.0)).sum(axis=0)
    np.testing.assert_array_equal(below, 8)


def test_all_trials_are_used_from_a_start_that_has_them() -> None:
    laxity = as_read()
    search = _search(laxity)
    start = search.model.parameters.start
    used = search.used(start)
    assert used.laxity is laxity
    assert used.start is start


def _search(laxity: Laxity, knee: Knee | None = None) -> TrialSearch:
    model = LaxityModel(knee=knee or small_knee(), protocol=laxity.protocol).with_tests(laxity)
    return TrialSearch(model=model, laxity=laxity, weighting="unit", bounds={})


@pytest.mark.usefixtures("no_conventions")
@pytest.mark.slow
def test_verbs_of_identification_begin_there_too_and_name_what_they_leave_out() -> None:
    laxity = displaced(as_read())
    found = ik.information(slack(), laxity, noise="0.3mm,0.3deg")
    assert any("measured pose" in x for x in found.assumptions)
    (lost,) = [x for x in found.findings if x.where == "trials"]
    assert (lost.code, lost.values["n_used"]) == ("trials-lost", laxity.n - 1)


def test_only_the_start_moves_and_priors_stay_centred_on_the_subject() -> None:
    knee, used = knee_with_equilibria(slack(), as_read(), "subject")
    assert used.is_moved
    parameters = LaxityModel(knee=knee, protocol=as_read().protocol).parameters
    strains = [x.endswith("reference_strain_pct") for x in parameters.names]
    np.testing.assert_array_equal(parameters.center[strains], -30.0)
    assert (parameters.start[strains] > -20.0).all()
    same, there = knee_with_equilibria(small_knee(), as_read(), "subject")
    assert not there.is_moved
    assert dict(same.fitted or {}) == dict(small_knee().fitted or {})


@pytest.mark.slow
def test_a_diagnosis_begins_there_too() -> None:
    laxity = displaced(as_read())
    effects = [effect_named(slack(), "flexion_offset")]
    found = ik.diagnose(slack(), laxity, noise="0.3mm,0.3deg", effects=effects)
    assert found.verdict is Verdict.ADEQUATE
    # Its priors of strains do not count, which the question tells.
    strains = {f"{x.name}.reference_strain_pct" for x in slack().ligaments}
    assert found.question is not None
    assert strains <= set(found.question.priors_set_aside)
    fitted = ik.fit(slack(), laxity, noise="0.3mm,0.3deg", priors=True)
    assert fitted.question is not None
    words = IN_WORDS["priors_set_aside"]
    assert words in found.question.differences(fitted.question)
    assert "trials-lost" in {x.code for x in found.findings}


def test_the_folder_of_a_fit_predicts_its_table_without_the_measured_poses(tmp_path: Path) -> None:
    """Insertions, frames, parameters and poses of the fit are all in the folder."""
    laxity = as_read()
    noise = 0.1 * np.random.default_rng(3).normal(size=(laxity.n, 5))
    shifted = laxity.coordinates + noise
    table = write_laxity(replace(laxity, coordinates=shifted), tmp_path / "table.csv")
    uncertain = "insertions=1mm,registration=2deg,registration=1mm"
    knee = write_subject(small_knee(), tmp_path / "knee")
    fitted = ik.fit(knee, table, uncertain=uncertain, out=tmp_path / "fit")
    predicted = ik.simulate(tmp_path / "fit" / "fitted", str(table))
    np.testing.assert_allclose(predicted.coordinates, fitted.coordinates, atol=0.05)
    assert predicted.rmse is not None
    assert predicted.rmse.mm == pytest.approx(fitted.rmse.mm, rel=0.02)
    assert predicted.assumptions
    # Taken as exact, they stay where the fit put them.
    exactly = read_subject(tmp_path / "fit" / "fitted").with_uncertainty(Uncertainty())
    model = LaxityModel(knee=exactly, protocol=laxity.protocol)
    assert not any(x.startswith("registration") for x in model.parameters.names)
    again = ik.simulate(exactly, str(table))
    np.testing.assert_allclose(again.coordinates, predicted.coordinates, atol=1e-6)


@pytest.mark.slow
def test_a_robust_fit_is_not_moved_by_a_wrong_row() -> None:
    laxity = as_read()
    coordinates = np.array(laxity.coordinates)
    coordinates += 0.05 * np.random.default_rng(7).normal(size=coordinates.shape)
    truth = ik.fit(small_knee(), replace(laxity, coordinates=coordinates)).theta
    coordinates[3] += [1.0, 2.0, 0.0, 2.0, 4.0]
    wrong = replace(laxity, coordinates=coordinates)
    plain = ik.fit(small_knee(), wrong)
    robust = ik.fit(small_knee(), wrong, likelihood="student")
    strains = slice(4, 8)
    off = np.abs(np.array([plain.theta, robust.theta]) - truth)[:, strains].max(axis=1)
    assert off[1] < 0.25 * off[0]
    (said,) = [x for x in robust.assumptions if x.startswith("Errors were modelled as Student's t")]
    assert "trial 3 (0.0" in said


def test_trials_along_paths_that_the_start_loses_are_regained() -> None:
    """Insertions given 4 mm off lose trials of a nominal protocol; stated, all come back."""
    knee = ik.reference_knee(edge_mm=2.0)
    protocol = ik.load_protocol("table2")
    truth = LaxityModel(knee=knee, protocol=protocol)
    laxity = truth.simulate(truth.parameters.start)
    generator = np.random.default_rng(14)
    moved = [
        replace(
            x,
            femur=x.femur + generator.normal(0.0, 4.0, 3),
            tibia=x.tibia + generator.normal(0.0, 4.0, 3),
        )
        for x in knee.ligaments
    ]
    given = knee.with_ligaments(moved).with_uncertainty(Uncertainty(insertions_mm=4.0))
    model = LaxityModel(knee=given, protocol=protocol)
    lost = ~model.predict(model.parameters.start).is_converged
    assert lost.any()
    found = ik.fit(given, ik.add_noise(laxity, sd_mm=0.5, sd_deg=0.5, seed=0))
    assert found.trials_used == protocol.trials
    said = " ".join(found.assumptions)
    assert "measured trials had no equilibrium" in said
    assert found.rmse.mm < 1.0
    assert found.rmse.deg < 1.0


@pytest.mark.slow
def test_a_stated_noise_weighs_as_columns_of_the_table_do() -> None:
    laxity = as_read()
    coordinates = laxity.coordinates + np.random.default_rng(5).normal(size=(laxity.n, 5))
    table = replace(laxity, coordinates=coordinates)
    sd = np.broadcast_to([0.5, 0.5, 0.5, 2.0, 2.0], coordinates.shape)
    stated = ik.fit(small_knee(), table, noise="0.5mm,2deg", budget=20)
    columns = ik.fit(small_knee(), replace(table, sd=sd), weighting="noise", budget=20)
    np.testing.assert_array_equal(stated.theta, columns.theta)
    assert stated.objective != ik.fit(small_knee(), table, budget=20).objective


@pytest.mark.parametrize("n", [1, 2, 3])
def test_starts_from_measured_poses_are_by_stretch_and_as_many_as_asked_for(n: int) -> None:
    laxity = as_read()
    model = LaxityModel(knee=small_knee(), protocol=laxity.protocol).with_tests(laxity)
    assert model.poses is not None
    start = model.parameters.start
    starts = starts_elsewhere(model, start, n)
    assert starts.shape == (n, model.parameters.n)
    np.testing.assert_array_equal(starts, starts_by_stretch(model, start, n))
    assert len({tuple(x) for x in starts.tolist()}) == n
