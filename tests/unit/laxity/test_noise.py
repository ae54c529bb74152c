from dataclasses import replace

import numpy as np
import pytest

from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.runs.declare import Array

N = 20_000
# Five standard errors of a mean, a spread or a correlation over N trials; each draw of a heavy tail
# (10 degrees of freedom, kurtosis 4) counts as 2.5 of a normal one in a spread.
FIVE_SIGMA = 5 / np.sqrt(N)


def quiet(n: int = N) -> Laxity:
    return Laxity(
        protocol=Protocol(
            name="many",
            trials=tuple(f"t{i}" for i in range(n)),
            flexion_deg=np.zeros(n),
            loads=np.zeros((n, 5)),
        ),
        coordinates=np.zeros((n, 5)),
    )


def scaled(noisy: Laxity) -> Array:
    assert noisy.sd is not None
    return np.asarray(noisy.coordinates / noisy.sd)


@pytest.mark.parametrize("degrees", [None, 10.0])
@pytest.mark.parametrize("correlation", [0.0, 0.5, -0.2])
def test_errors_have_the_stated_spread_and_correlation(
    degrees: float | None, correlation: float
) -> None:
    noisy = add_noise(
        quiet(), sd_mm=0.3, sd_deg=2.0, seed=1, correlation=correlation, student_degrees=degrees
    )
    assert noisy.sd is not None
    assert noisy.sd[0].tolist() == [0.3, 0.3, 0.3, 2.0, 2.0]
    assert noisy.within_trial_correlation == correlation
    errors = scaled(noisy)
    np.testing.assert_allclose(errors.mean(axis=0), 0, atol=FIVE_SIGMA)
    np.testing.assert_allclose(errors.std(axis=0), 1, atol=FIVE_SIGMA * np.sqrt(1.25))
    expected = np.where(np.eye(5) == 1, 1.0, correlation)
    np.testing.assert_allclose(np.corrcoef(errors.T), expected, atol=FIVE_SIGMA * np.sqrt(2))


def test_few_degrees_of_freedom_have_heavy_tails() -> None:
    normal = scaled(add_noise(quiet(), sd_mm=1, sd_deg=1, seed=2))
    heavy = scaled(add_noise(quiet(), sd_mm=1, sd_deg=1, seed=2, student_degrees=3))
    # Beyond four standard deviations: 6e-5 of a normal distribution, 6e-3 of this t.
    assert (np.abs(heavy) > 4).mean() > 20 * (np.abs(normal) > 4).mean()


def test_a_seed_gives_one_answer() -> None:
    first, again, other = (
        add_noise(quiet(9), sd_mm=1, sd_deg=1, seed=seed).coordinates for seed in (3, 3, 4)
    )
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


def test_what_is_not_measured_stays_so_and_changes_nothing_else() -> None:
    whole = add_noise(quiet(9), sd_mm=1, sd_deg=1, seed=3)
    holes = np.zeros((9, 5))
    holes[4, 1] = np.nan
    partly = add_noise(replace(quiet(9), coordinates=holes), sd_mm=1, sd_deg=1, seed=3)
    np.testing.assert_array_equal(
        partly.coordinates, np.where(np.isnan(holes), np.nan, whole.coordinates)
    )


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"sd_mm": 0.0}, "sd_mm must be greater than 0 and finite, got 0"),
        ({"sd_deg": np.nan}, "sd_deg must be greater than 0 and finite, got nan"),
        ({"correlation": 1.0}, "the within-trial correlation is 1. It must lie"),
        ({"student_degrees": 2.0}, "student_degrees must be greater than 2"),
    ],
)
def test_settings_out_of_range(settings: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        add_noise(quiet(2), **({"sd_mm": 1.0, "sd_deg": 1.0} | settings), seed=0)


def test_noise_is_added_once() -> None:
    noisy = add_noise(quiet(2), sd_mm=1, sd_deg=1, seed=0)
    with pytest.raises(ValueError, match="noise once"):
        add_noise(noisy, sd_mm=1, sd_deg=1, seed=0)
