"""Forces in a diagnosis: signatures of causes in them, and what they alone can show."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from replayed_paths import in_situ_forces

import identknee as ik
from identknee.calibrate.problem import FORCE_TERM, SUPERPOSITION_TERM
from identknee.diagnosis.candidates import library_variants
from identknee.diagnosis.fitting import (
    FittedModel,
    base_model,
    best_fit_from,
    fitted_with_nuisances,
    stated_noise,
    whitened_problem,
)
from identknee.diagnosis.force_rows import ForceRows
from identknee.diagnosis.missing_line import (
    candidate_lines,
    line_gradients,
)
from identknee.laxity.experiment_tables import joined
from identknee.laxity.experiments import Experiment
from identknee.laxity.forces import MeasuredForces
from identknee.laxity.table import Laxity
from identknee.model.effects.effect import Effect
from identknee.model.effects.library import effect_named
from identknee.model.effects.loads import compression
from identknee.model.effects.tissues import toe_strain
from identknee.model.laxity_model import LaxityModel
from identknee.model.quantities import quantity_named
from identknee.runs.declare import Array
from identknee.runs.record import Outcome
from identknee.subject.knee import Knee, Uncertainty

pytestmark = pytest.mark.usefixtures("no_conventions")

NAMES, SD_N = ("ACL.tension_N", "contact.medial_N"), 5.0
PROTOCOL = ik.load_protocol("seed63")


def _measured(knee: Knee, seed: int, every: int = 3) -> Laxity:
    """Laxity, two forces in each trial, and the ACL's in three replayed paths, all with noise."""
    trials = PROTOCOL.select(range(0, PROTOCOL.n, every))
    model = LaxityModel(knee=knee, protocol=trials)
    theta, generator = model.parameters.start, np.random.default_rng(seed)
    found = model.predict(theta)
    true = [[quantity_named(model, f"{x}@{t}").value(found) for x in NAMES] for t in trials.trials]
    noise = generator.normal(scale=0.3, size=found.coordinates.shape)
    forces = np.array(true) + generator.normal(scale=SD_N, size=(trials.n, len(NAMES)))
    rows = [(x, "ACL", "intact", "cut: ACL") for x in trials.trials[:3]]
    return Laxity(
        protocol=trials,
        coordinates=found.coordinates + noise,
        sd=np.full(noise.shape, 0.3),
        forces=MeasuredForces(names=NAMES, values=forces, sd=np.full(forces.shape, SD_N)),
        superposition=in_situ_forces(model, theta, rows, generator=generator),
    )


@pytest.fixture(scope="module")
def fitted(reference: Knee) -> FittedModel:
    laxity = _measured(reference, 1, every=9)
    model = base_model(reference, laxity.protocol)
    plain = best_fit_from(model, laxity, stated_noise(laxity), [model.parameters.start])
    return fitted_with_nuisances(plain, np.full(laxity.coordinates.shape, 0.3), 0.0)


def _jacobian(fitted: FittedModel, effects: list[Effect], values: Array) -> Array:
    model = fitted.model.with_effects([*fitted.model.effects, *effects])
    problem = whitened_problem(model, fitted.laxity, fitted.noise)
    jacobian = problem.jacobian(np.r_[fitted.theta, values])
    return jacobian[: fitted.n_data, fitted.theta.size :]


def test_rows_are_coordinates_then_forces_then_priors(fitted: FittedModel) -> None:
    n, p = fitted.laxity.n, fitted.theta.size
    assert fitted.n_coordinates == 5 * n
    assert fitted.n_data == 5 * n + 2 * n + 18
    assert len(fitted.evaluation.residuals) == fitted.n_data + p
    terms = {x.name: x.n for x in fitted.evidence}
    assert (terms[FORCE_TERM], terms[SUPERPOSITION_TERM]) == (2 * n, 18)
    forces = fitted.compared_forces
    assert forces is not None
    assert len(forces.names) == 2 * n + 18


def test_signatures_are_derivatives_of_all_rows(fitted: FittedModel) -> None:
    """Also those of a structure that may be elsewhere, which come from its pull alone."""
    knee = fitted.model.knee
    effects = [compression(), effect_named(knee, "moment_gain_IE"), effect_named(knee, "deep_mcl")]
    for variant in library_variants(fitted, effects):
        expected = _jacobian(fitted, [variant.effect], variant.values)[:, variant.moved]
        size = np.abs(expected).max()
        np.testing.assert_allclose(variant.signature.columns, expected, atol=1e-6 * size)
        assert np.abs(expected[fitted.n_coordinates :]).max() > 0.0


def test_a_line_of_force_changes_forces_as_a_load_does(fitted: FittedModel) -> None:
    rows = fitted.forces
    lines = candidate_lines(fitted.model.knee, seed=0, most=5)
    gradients = line_gradients(fitted.model, fitted.model.predict_once(fitted.theta), lines)
    changes = rows.changes(fitted.theta, gradients[:, :, 0])
    model = fitted.model
    lack = ForceRows(model=model, laxity=fitted.laxity)
    twice = lack.changes(fitted.theta, 2.0 * gradients[:, :, 0])
    np.testing.assert_allclose(twice, 2.0 * changes, rtol=1e-9)
    # A force along the femur is the gradient of no other than the compression effect.
    push = rows.under([compression()]).jacobian(np.r_[fitted.theta, 0.0])[:, -1]
    acted = compression().change(model.setting(fitted.theta), np.array([1.0])).loads
    change = (acted - model.setting(fitted.theta).loads)[model.paths.trial_node]
    np.testing.assert_allclose(
        rows.changes(fitted.theta, -change[:, :, None])[:, 0], push, atol=1e-6 * np.abs(push).max()
    )


def test_nuisances_of_the_table_are_those_of_its_forces(reference: Knee) -> None:
    knee = reference.with_uncertainty(
        Uncertainty(trial_flexion_deg=0.5, surface_mm=0.1, zero_mm=0.3)
    )
    laxity = _measured(reference, 1, every=9)
    model = base_model(knee, laxity.protocol)
    rows, theta = ForceRows(model=model, laxity=laxity), model.parameters.start
    plain = best_fit_from(model, laxity, stated_noise(laxity), [theta], most_steps=1)
    fitted = fitted_with_nuisances(plain, np.full(laxity.coordinates.shape, 0.3), 0.0)
    assert fitted.noise.beside is not None
    assert fitted.noise.beside.shape == (rows.n, fitted.noise.nuisances.shape[1])
    toe = rows.under([toe_strain()]).jacobian(np.r_[theta, 0.0])[:, -1]
    columns = rows.nuisances(theta)
    assert np.isclose(columns, toe[:, None]).all(axis=0).any()


@pytest.mark.slow
def test_errors_of_a_rig_are_none_of_the_extended_knee(reference: Knee, tmp_path: Path) -> None:
    laxity = _measured(reference, 1, every=9)
    rig = Experiment(name="a", rig="robot", mounting="robot-1", uncertainty={"load_cell_N": 3.0})
    whole = joined([(rig, laxity)])
    ik.diagnose(reference, whole, effects=[compression()], out=tmp_path / "out")
    extended = ik.read_subject(tmp_path / "out" / "extended")
    assert all("/" not in x.name for x in extended.effects)
    start = tmp_path / "out" / "extended" / "fitted.toml"
    again = ik.fit(extended, whole, start=str(start), more_starts=0)
    assert again.search.outcome is not Outcome.START_FAILED


@pytest.mark.slow
def test_a_cause_is_named_beside_forces(reference: Knee) -> None:
    """A moment that is 15 % larger than read changes both."""
    exact = _measured(reference, 2, every=4)
    protocol = exact.protocol
    loads = np.array(protocol.loads)
    loads[:, 0] *= 1.15
    louder = replace(protocol, loads=loads)
    model = LaxityModel(knee=reference, protocol=louder)
    found = model.predict(model.parameters.start)
    generator = np.random.default_rng(3)
    true = [[quantity_named(model, f"{x}@{t}").value(found) for x in NAMES] for t in louder.trials]
    forces = np.array(true) + generator.normal(scale=SD_N, size=(louder.n, len(NAMES)))
    laxity = Laxity(
        protocol=protocol,
        coordinates=found.coordinates + generator.normal(scale=0.3, size=(louder.n, 5)),
        sd=np.full((louder.n, 5), 0.3),
        forces=MeasuredForces(names=NAMES, values=forces, sd=np.full(forces.shape, SD_N)),
    )
    found_with = ik.diagnose(
        reference, laxity, effects=[effect_named(reference, "moment_gain_IE"), compression()]
    )
    assert found_with.cause_names == ("moment_gain_IE",)
    assert found_with.forces_before is not None
    assert found_with.forces_after is not None
    left = [
        float(np.mean(((x.measured - x.predicted) / x.sd) ** 2))
        for x in (found_with.forces_before, found_with.forces_after)
    ]
    assert left[1] < 1.5
    assert left[1] < left[0]


@pytest.mark.slow
def test_forces_that_no_knee_of_this_laxity_has_are_a_misfit(reference: Knee) -> None:
    laxity = _measured(reference, 2, every=6)
    assert laxity.forces is not None
    p_values = []
    for factor in (1.0, 2.0):
        values = np.array(laxity.forces.values)
        values[values > 0.0] *= factor
        changed = replace(laxity, forces=replace(laxity.forces, values=values))
        found = ik.diagnose(reference, changed, effects=[compression()])
        assert found.p_value is not None
        p_values.append(found.p_value)
    assert p_values[0] > 0.05
    assert p_values[1] < 1e-6
