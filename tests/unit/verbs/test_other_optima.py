"""Other parameter sets that fit as well, as `fit` lists them."""

import numpy as np
import pytest

import identknee as ik
from identknee.laxity.table import TRANSLATIONS
from identknee.verbs.fit import Calibration


@pytest.fixture(scope="module")
def fitted() -> Calibration:
    """Fifteen values of the reference knee, which eight parameters fit in many ways."""
    knee, protocol = ik.reference_knee(), ik.load_protocol("drawer").select([2, 5, 8])
    laxity = ik.add_noise(ik.simulate(knee, protocol).laxity, sd_mm=0.5, sd_deg=0.5, seed=1)
    return ik.fit(knee, laxity, noise="1mm,2deg")


def _simulated(fitted: Calibration, theta: np.ndarray) -> ik.Simulation:
    values = dict(zip(fitted.parameter_names, theta.tolist(), strict=True))
    return ik.simulate(ik.reference_knee(), fitted.protocol, values=values)


def test_each_fits_as_well_and_differs_in_a_force(fitted: Calibration) -> None:
    assert len(fitted.optima) >= 2
    sd = np.full(5, 2.0)
    sd[TRANSLATIONS] = 1.0
    ends = [fitted.search.theta, *(x.theta for x in fitted.optima)]
    knees = [_simulated(fitted, x) for x in ends]
    deviances = [np.sum(((x.coordinates - fitted.data.coordinates) / sd) ** 2) for x in knees]
    names = [x.name for x in ik.reference_knee().ligaments]
    for own, knee, deviance in zip(fitted.optima, knees[1:], deviances[1:], strict=True):
        assert own.rise == pytest.approx(deviance - deviances[0], abs=1e-6)
        assert 0.0 <= own.rise <= 3.84
        apart = np.abs(knee.tension_N - knees[0].tension_N)
        trial, ligament = np.unravel_index(np.argmax(apart), apart.shape)
        assert own.quantity == f"{names[ligament]}.tension_N@{fitted.protocol.trials[trial]}"
        assert own.force_N == pytest.approx(knee.tension_N[trial, ligament], abs=1e-4)
        assert own.force_at_fit_N == pytest.approx(knees[0].tension_N[trial, ligament], abs=1e-4)
