"""Errors averaged over to first order against the covariance of all parameters together."""

import re
from dataclasses import replace

import numpy as np
import pytest
from held import both_of
from replayed_paths import in_situ_forces
from tolerances import CLOSED_FORM

import identknee as ik
from identknee.laxity.experiment_tables import joined
from identknee.laxity.experiments import Experiment
from identknee.laxity.forces import MeasuredForces
from identknee.laxity.table import Laxity, add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import structure_loads
from identknee.runs.executors import serial
from identknee.subject.knee import Knee, with_stated_uncertainty
from identknee.verbs.identification import Identification, identification
from identknee.verbs.marginalise_nuisances import marginalise_nuisances

FIXED = both_of("LCL", "MCL")
# The two sides solve the same normal equations by other routes.
SOLVED = 1e6 * CLOSED_FORM


@pytest.fixture(scope="module")
def knee() -> Knee:
    knee = ik.example("reference")
    return knee.with_uncertainty(
        with_stated_uncertainty(knee.uncertainty, "insertions=1mm,contact_modulus=20%")
    )


@pytest.fixture(scope="module")
def measured(reference_model: LaxityModel) -> Laxity:
    """Few trials with more error than noise, so that nuisances leave the middle of their priors."""
    small = reference_model.with_protocol(reference_model.protocol.select(range(0, 63, 6)))
    return add_noise(small.simulate(small.parameters.center), sd_mm=0.3, sd_deg=0.5, seed=1)


@pytest.fixture(scope="module")
def setup(knee: Knee, measured: Laxity) -> Identification:
    return identification(knee, measured, fixed=FIXED)


@pytest.fixture(scope="module")
def marginal(setup: Identification) -> Identification:
    return marginalise_nuisances(setup, seed=0, executor=serial)[0]


def test_the_parameters_of_interest_remain(setup: Identification, marginal: Identification) -> None:
    assert marginal.problem.parameters.names == setup.problem.parameters.names_of_interest
    assert marginal.free.parameters.names == marginal.problem.parameters.names


def test_it_starts_at_the_best_fit_of_all_parameters(marginal: Identification) -> None:
    problem, best = marginal.nuisances_at or pytest.fail("nothing was averaged over")
    np.testing.assert_array_equal(marginal.start, best[problem.parameters.is_of_interest])


def _with_forces(knee: Knee, measured: Laxity) -> Laxity:
    """A rig whose cell has a constant error, with tensions and in-situ forces."""
    rig = Experiment(name="a", rig="r", mounting="r-1", uncertainty={"load_cell_N": 3.0})
    whole = joined([(rig, measured)])
    model = LaxityModel(knee=knee, protocol=whole.protocol)
    theta, n = model.parameters.start, measured.n
    found = structure_loads(model, model.predict(theta))
    tensions = found.tensions[:, [found.names.index("ACL")]]
    generator = np.random.default_rng(3)
    forces = MeasuredForces(
        names=("ACL.tension_N",),
        values=tensions + generator.normal(scale=10.0, size=(n, 1)),
        sd=np.full((n, 1), 10.0),
    )
    rows = [
        (trial, *x)
        for trial in whole.protocol.trials[:3]
        for x in (("PCL", "intact", "cut: PCL"), ("ACL", "cut: PCL", "cut: ACL, PCL"))
    ]
    made = in_situ_forces(model, theta, rows, pose_sd=(0.05, 0.05), generator=generator)
    return replace(whole, forces=forces, superposition=made)


@pytest.fixture(scope="module")
def with_other_terms(knee: Knee, measured: Laxity) -> Identification:
    setup = identification(knee, _with_forces(knee, measured), fixed=FIXED)
    return marginalise_nuisances(setup, seed=0, executor=serial)[0]


@pytest.mark.parametrize("which", ["marginal", "with_other_terms"])
def test_information_is_that_of_the_marginal_covariance(
    which: str, request: pytest.FixtureRequest
) -> None:
    marginal: Identification = request.getfixturevalue(which)
    problem, best = marginal.nuisances_at or pytest.fail("nothing was averaged over")
    is_asked = problem.parameters.is_of_interest
    full = problem.jacobian(best)
    covariance = np.linalg.inv(full.T @ full)[np.ix_(is_asked, is_asked)]
    own = marginal.problem.jacobian(best[is_asked])
    np.testing.assert_allclose(np.linalg.inv(own.T @ own), covariance, rtol=SOLVED)


@pytest.mark.parametrize("which", ["marginal", "with_other_terms"])
def test_the_gradient_is_that_of_the_deviance_with_nuisances_fitted_anew(
    which: str, request: pytest.FixtureRequest
) -> None:
    marginal: Identification = request.getfixturevalue(which)
    problem, best = marginal.nuisances_at or pytest.fail("nothing was averaged over")
    is_asked = problem.parameters.is_of_interest
    residuals, jacobian = problem.residuals(best), problem.jacobian(best)
    nuisances = jacobian[:, ~is_asked]
    left = residuals - nuisances @ np.linalg.lstsq(nuisances, residuals, rcond=None)[0]
    here = marginal.problem.residuals(best[is_asked])
    assert here @ here == pytest.approx(left @ left, rel=SOLVED)
    np.testing.assert_allclose(
        marginal.problem.jacobian(best[is_asked]).T @ here,
        jacobian[:, is_asked].T @ left,
        atol=SOLVED * np.abs(jacobian).max(),
    )


def test_it_says_how_far_predictions_bend(marginal: Identification) -> None:
    n_marginalised, bend, n_draws = re.findall(r"\d+(?:\.\d+)?", marginal.assumptions[-1])
    assert int(n_marginalised) == 25
    assert 0.0 < float(bend) < 1.0
    assert 10 <= int(n_draws) <= 16


@pytest.mark.slow
def test_forces_beside_stated_errors_have_equivalents(with_other_terms: Identification) -> None:
    said = with_other_terms.assumptions[-1]
    assert re.findall(r"\d+(?:\.\d+)?", said)[0] == str(25 + 3)
    knee, laxity = with_other_terms.knee, with_other_terms.laxity
    found = ik.equivalents(knee, laxity, n_sets=2, forces="none", fixed=FIXED)
    assert all(x.startswith(("ACL", "PCL")) for x in found.region.parameters)
    alone = ik.equivalents(knee, laxity.without_forces(), n_sets=2, forces="none", fixed=FIXED)
    ends = [x.region.parameters["ACL.stiffness_kN"] for x in (found, alone)]
    widths = [x.largest - x.smallest for x in ends]
    assert widths[0] < widths[1]


def test_a_knee_known_exactly_is_left_alone(measured: Laxity) -> None:
    exact = identification(ik.example("reference"), measured, fixed=FIXED)
    same, fits = marginalise_nuisances(exact, seed=0, executor=serial)
    assert same is exact
    assert fits[0].parameters.names == exact.problem.parameters.names


def test_errors_beside_an_unknown_noise_are_refused(knee: Knee, measured: Laxity) -> None:
    unknown = identification(knee, replace(measured, sd=None), fixed=FIXED)
    with pytest.raises(ValueError, match=r"--noise 0\.5mm"):
        marginalise_nuisances(unknown, seed=0, executor=serial)


@pytest.mark.slow
def test_equivalents_list_ligament_parameters_alone(knee: Knee, measured: Laxity) -> None:
    found = ik.equivalents(knee, measured, n_sets=2, forces="none", fixed=FIXED)
    assert all(x.startswith(("ACL", "PCL")) for x in found.region.parameters)
    assert {x.name.split(".")[0] for x in found.nuisances} == {"insertion", "contact_modulus"}
