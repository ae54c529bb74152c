"""The generator and the model are neither twins nor strangers on a knee with nothing hidden."""

from dataclasses import replace

import numpy as np
import pytest
from slow_cases import some_slow

from identknee.blind.case import blind_case
from identknee.blind.conditions import stated_conditions
from identknee.blind.experiment import experiment_of, parameter_derivatives, run_experiment
from identknee.calibrate.fit import fit
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import ROTATIONS, TRANSLATIONS
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.residuals import LaxityResiduals
from identknee.subject.knee import Knee, with_stated_uncertainty

SD = 0.3
# What a null may leave after the fit of the ligament parameters, in units of the noise.
LEAST_SIGNAL, LARGEST_SIGNAL = 0.5, 3.0
SEEDS = (1, 2, 3)


def test_coordinates_are_close_and_not_the_same(
    reference: Knee, reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    trials = np.arange(0, reference_model.protocol.n, 12)
    run = run_experiment(experiment_of(reference, reference_model.protocol.select(trials)))
    assert run.is_complete
    difference = np.abs(run.coordinates - reference_prediction.coordinates[trials])
    assert 0.01 < difference[:, TRANSLATIONS].max() < 1.0
    assert 0.01 < difference[:, ROTATIONS].max() < 1.5


def test_slopes_are_those_of_runs(reference: Knee) -> None:
    protocol = load_protocol("seed63").select([0, 10, 30, 50])
    experiment = experiment_of(reference, protocol)
    theta = np.array(
        [x.stiffness_kN for x in reference.ligaments]
        + [x.reference_strain_pct for x in reference.ligaments]
    )
    run, size = run_experiment(experiment), 1e-3
    slopes = parameter_derivatives(experiment, run, len(reference.ligaments))
    for i, step in enumerate(size * np.eye(len(theta))):
        ahead, behind = (
            run_experiment(experiment.with_theta(theta + x), run).coordinates for x in (step, -step)
        )
        by_difference = (ahead - behind) / (2.0 * size)
        # Its Hessian is differenced too, across points that come into contact.
        np.testing.assert_allclose(slopes[:, :, i], by_difference, atol=5e-3)


def _signals(model: LaxityModel) -> list[float]:
    """What fits of the ligament parameters leave of nulls without noise."""
    signals = []
    for seed in SEEDS:
        case = blind_case(model.knee, seed=seed, effect=None, protocol=model.protocol)
        exact = replace(case.noise_free, sd=np.full((model.protocol.n, 5), SD))
        problem = LaxityResiduals(model=model, laxity=exact, weighting="noise")
        found = fit(problem, np.array(list(case.truth.theta.values())))
        signals.append(float(np.sqrt(2.0 * found.objective)))
    return signals


@pytest.mark.parametrize("which", some_slow(["reference_model", "stable_model"], ["stable_model"]))
def test_a_null_leaves_little(which: str, request: pytest.FixtureRequest) -> None:
    """Of an analytic knee and of a real one."""
    signals = _signals(request.getfixturevalue(which))
    assert min(signals) > LEAST_SIGNAL
    assert max(signals) < LARGEST_SIGNAL


@pytest.mark.parametrize(
    "uncertain",
    some_slow(
        [
            "insertions=2mm",
            "registration=2deg",
            "registration=2mm",
            "load_axes=3deg",
            "load_gain=10%",
        ],
        ["registration=2deg", "registration=2mm"],
    ),
)
def test_true_errors_are_the_nuisances_of_the_model(reference: Knee, uncertain: str) -> None:
    """A knee whose geometry or loads are wrong is the model at the values that `reveal` tells."""
    protocol = load_protocol("seed63").select(range(0, 63, 4))
    conditions = stated_conditions(uncertain)
    case = blind_case(reference, seed=3, effect=None, protocol=protocol, conditions=conditions)
    knee = reference.with_uncertainty(with_stated_uncertainty(reference.uncertainty, uncertain))
    model = LaxityModel(knee=knee, protocol=protocol)
    assert set(case.truth.stated_errors) == set(model.parameters.nuisance_names)
    exact, wrong = (
        model.predict(model.parameters.vector(x), derivatives=False).coordinates
        for x in (case.truth.theta, {**case.truth.theta, **case.truth.stated_errors})
    )
    off = [np.sqrt(np.nanmean((x - case.noise_free.coordinates) ** 2)) for x in (exact, wrong)]
    assert off[1] < 0.5 * off[0]
    assert off[1] < 0.2
