"""Trials kept from a fit and predicted by it."""

from dataclasses import replace

import numpy as np
import pytest
from slow_cases import some_slow
from small_knee import as_read, small_knee

import identknee as ik
from identknee.laxity.table import Laxity, add_noise
from identknee.verbs.fit import split

pytestmark = pytest.mark.usefixtures("no_conventions")

HELD = ["trial 2", "trial 7", "trial 9"]


def noisy(seed: int) -> Laxity:
    return replace(add_noise(as_read(), sd_mm=0.2, sd_deg=0.2, seed=seed), sd=None)


def test_trials_are_held_out_by_name_or_pattern() -> None:
    laxity = as_read()
    kept, held = split(laxity, ["trial 2", "*7"])
    assert np.flatnonzero(held).tolist() == [2, 7]
    assert not kept.is_measured[held].any()
    assert kept.is_measured[~held].all()
    assert split(laxity, [])[0] is laxity


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["trail 2"], "--hold-out trail 2: there is no such trial"),
        (["*"], "leaves no trial to fit"),
    ],
)
def test_names_that_hold_out_nothing_or_all(names: list[str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        split(as_read(), names)


def test_predictions_do_not_see_what_was_measured() -> None:
    laxity = noisy(1)
    coordinates = np.array(laxity.coordinates)
    coordinates[[2, 7, 9]] += 3.0
    found = ik.fit(small_knee(), laxity, hold_out=HELD, uncertain="registration=1deg").held_out
    other = ik.fit(
        small_knee(),
        replace(laxity, coordinates=coordinates),
        hold_out=HELD,
        uncertain="registration=1deg",
    ).held_out
    assert found is not None
    assert other is not None
    assert found.trials == tuple(HELD)
    assert [x.predicted for x in found.values] == [x.predicted for x in other.values]
    assert [x.sd for x in found.values] == [x.sd for x in other.values]
    assert other.within_90 < 0.2 < found.within_90


@pytest.mark.slow
def test_intervals_hold_what_they_say() -> None:
    inside, sds = [], []
    for seed in range(6):
        fitted = ik.fit(small_knee(), noisy(seed), hold_out=HELD)
        assert fitted.held_out is not None
        assert fitted.rmse.n_compared == 5 * (as_read().n - len(HELD))
        inside.append(fitted.held_out.within_90)
        sds += [x.sd for x in fitted.held_out.values if x.coordinate.endswith("_mm")]
    # 90 values: 90 % of them within 3.2 standard errors, nine in ten of the noise being theirs.
    assert 0.8 <= np.mean(inside) <= 1.0
    assert 0.1 < min(sds) < 0.4


@pytest.mark.parametrize("noise", some_slow(["0.2mm,0.2deg", "0.1mm,0.1deg"], ["0.1mm,0.1deg"]))
def test_intervals_are_in_mm_and_deg_where_the_noise_is_stated(noise: str) -> None:
    plain = ik.fit(small_knee(), noisy(1), hold_out=HELD).held_out
    stated = ik.fit(small_knee(), noisy(1), hold_out=HELD, noise=noise).held_out
    assert plain is not None
    assert stated is not None
    # Noise of one size is what the fit leaves, whatever size was stated.
    sds = [x.sd for x in plain.values]
    assert [x.sd for x in stated.values] == pytest.approx(sds, rel=1e-3)
