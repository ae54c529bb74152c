"""Zeros stated to be uncertain count in a fit, as in every verb, and between mountings."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import small_knee, small_protocol

import identknee as ik
from identknee.laxity.experiment_tables import joined
from identknee.laxity.experiments import Experiment
from identknee.laxity.table import Laxity, add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.runs.declare import Array

SD, ZERO = 0.1, 0.5
STATED = f"zero={ZERO}mm,zero={ZERO}deg"
NOISE = f"{SD}mm,{SD}deg"


def _mounted(seed: int) -> Laxity:
    """Laxity of the small knee, mounted with an error of its own at every flexion angle."""
    model = LaxityModel(knee=small_knee(), protocol=small_protocol())
    exact = model.simulate(model.parameters.start)
    noisy = add_noise(exact, sd_mm=SD, sd_deg=SD, seed=seed)
    coordinates = np.array(noisy.coordinates)
    generator = np.random.default_rng(seed)
    angles = model.protocol.flexion_deg
    for angle in np.unique(angles):
        coordinates[angles == angle] += generator.normal(0.0, ZERO, 5)
    return replace(noisy, coordinates=coordinates)


def _fit(data: Laxity, **options: object) -> ik.Calibration:
    made: ik.Calibration = ik.fit(small_knee(), data, noise=NOISE, more_starts=0, **options)  # type: ignore[arg-type]
    return made


def _deviance(answer: ik.Calibration) -> float:
    return float(sum(x.deviance for x in answer.evidence))


def test_the_misfit_is_that_of_the_noise_beside_zeros() -> None:
    data = _mounted(3)
    exact, stated = _fit(data), _fit(data, uncertain=STATED)
    n = int(data.is_measured.sum())
    assert _deviance(exact) > 4.0 * n
    # A chi-square of fewer than n degrees of freedom, within 4 standard deviations.
    assert _deviance(stated) < n + 4.0 * np.sqrt(2.0 * n)
    assert "misfit-improbable" not in {x.code for x in stated.findings}


def test_other_verbs_have_the_same_deviance_at_their_fit() -> None:
    data = _mounted(3)
    found = _fit(data, uncertain=STATED)
    information = ik.information(small_knee(), data, noise=NOISE, uncertain=STATED)
    assert _deviance(found) == pytest.approx(
        sum(x.deviance for x in information.evidence), abs=1e-3
    )


def _of_two_mountings(seed: int, shift: Array) -> Laxity:
    first, second = _mounted(seed), _mounted(seed + 1)
    moved = replace(second, coordinates=second.coordinates + shift)
    names = [Experiment(name=f"e{i}", rig="robot", mounting=f"m{i}") for i in range(2)]
    return joined(list(zip(names, (first, moved), strict=True)))


def test_mountings_of_other_zeros_agree() -> None:
    agreement = _fit(_of_two_mountings(5, np.zeros(5)), uncertain=STATED).agreement
    assert agreement is not None
    assert agreement.p_value > 0.01


@pytest.mark.slow
def test_mountings_farther_apart_than_stated_do_not() -> None:
    """A wrong model of one table is no zero: trials under load are moved, the unloaded are not."""
    data = _of_two_mountings(5, np.zeros(5))
    is_moved = (np.array(data.protocol.experiment) == "e1") & (data.protocol.loads != 0.0).any(
        axis=1
    )
    bent = np.where(is_moved[:, None], 1.3, 1.0) * data.coordinates
    found = _fit(replace(data, coordinates=bent), uncertain=STATED).agreement
    assert found is not None
    assert found.p_value < 0.01
