"""The study of a believable knee: its scores, and predictions beside an error of the model."""

from types import ModuleType

import numpy as np
import pytest
from scipy.stats import norm, t
from small_knee import as_read, small_knee
from study_modules import STUDIES, study_module

import identknee as ik
from identknee.calibrate.problem import with_nuisance_priors
from identknee.model.discrepancy import SmoothDiscrepancy
from identknee.verbs.identification import with_noise

FOLDER = STUDIES / "17_believable_knee"
HALF = norm.ppf(0.95)


def load(name: str) -> ModuleType:
    return study_module(FOLDER / f"{name}.py")


def test_a_score_is_the_width_and_twenty_times_what_is_beyond() -> None:
    scores = load("scores").scores
    inside = ["a", "varus_deg", 1.0, 1.5, 3.0]
    beyond = ["b", "anterior_drawer_mm", 10.0, 1.0, 2.0]
    lost = ["c", "varus_deg", 1.0, None, None]
    found = scores([inside, beyond, lost], None)
    assert found["a", "varus_deg"] == pytest.approx(2.0 * HALF * 3.0 / 1.5)
    width = 2.0 * HALF * 2.0
    assert found["b", "anterior_drawer_mm"] == pytest.approx(width + 20.0 * (9.0 - HALF * 2.0))
    assert len(found) == 2
    wider = scores([inside], 3.0)["a", "varus_deg"]
    assert wider == pytest.approx(2.0 * t.ppf(0.95, 3.0) * 3.0 / 1.5)


def test_two_fits_are_compared_where_both_predict() -> None:
    difference = load("scores").difference
    plain = {(f"t{k}", "varus_deg"): 5.0 + k for k in range(20)}
    other = {key: value - 2.0 for key, value in plain.items() if key[0] != "t3"}
    assert difference(other, plain) == pytest.approx((-2.0, -2.0, -2.0))
    # Trials that differ widely do not tell two fits apart.
    apart = {key: value + 8.0 * (-1) ** k for k, (key, value) in enumerate(plain.items())}
    mean, low, high = difference(apart, plain)
    assert mean == pytest.approx(0.0)
    assert low < -1.0
    assert high > 1.0


def test_shares_and_errors_leave_out_what_is_not_predicted() -> None:
    module = load("scores")
    values = [
        ["Anterior_30", "anterior_drawer_mm", 0.0, 1.0, 1.0],
        ["Varus_30", "varus_deg", 0.0, 3.0, 1.0],
        ["Varus_60", "varus_deg", 0.0, None, None],
    ]
    assert module.within(values, None) == 0.5
    assert module.rms(values, "varus_deg") == 3.0
    assert module.rms(values, begin="Anterior") == 1.0
    assert module.rms(values) == pytest.approx(np.sqrt(5.0))
    assert np.isnan(module.rms(values, begin="Internal"))


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_what_the_data_say_of_an_error_of_the_model_is_predicted(size: float) -> None:
    module = load("predictions")
    laxity = with_noise(ik.add_noise(as_read(), sd_mm=0.5, sd_deg=0.5, seed=3), "0.01mm,0.01deg")
    model = ik.LaxityModel(knee=small_knee(), protocol=laxity.protocol).with_tests(laxity)
    problem = ik.LaxityResiduals(model=model, laxity=laxity, weighting="noise")
    theta = model.parameters.start
    # So short that trials say next to nothing of one another.
    error = SmoothDiscrepancy(
        sd=np.full(5, size),
        flexion_length=0.02,
        load_length=0.02,
        columns=np.zeros((laxity.n, 5, 0)),
    )
    fitted = module.FittedModel(
        model=model,
        laxity=laxity,
        theta=theta,
        problem=with_nuisance_priors(problem),
        error=error,
    )
    found = module.predicted(fitted, laxity.protocol)
    own = model.predict(theta).coordinates
    expected = laxity.coordinates if size else own
    assert np.abs(own - laxity.coordinates).max() > 0.3
    assert np.allclose(found.mean, expected, atol=0.01)
    rows = module.values(found, laxity)
    assert len(rows) == laxity.n_values
    assert min(x[4] for x in rows) >= 0.01
