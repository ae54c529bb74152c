"""What blind cases are drawn from: each number has the spread that its condition says."""

import numpy as np
import pytest
from blind_axes import AXES, PRIOR, TWICE, conditions_of

from identknee.blind.case import blind_case
from identknee.blind.conditions import STANDARD, Conditions, TruncatedNormal
from identknee.blind.effects import LISTED
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.subject.reference import reference_knee

N = 4000
# Of a sample of N, five standard errors of its standard deviation, as a share of it.
SD_SHARE = 5.0 / np.sqrt(2.0 * N)


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return load_protocol("seed63").select([0, 21, 42])


@pytest.fixture
def generator() -> np.random.Generator:
    return np.random.default_rng(8)


def test_places_have_the_jitter_of_every_coordinate(generator: np.random.Generator) -> None:
    """3 mm is how far apart published places of one structure lie; 0 would hide a wrong library."""
    middle = np.array([10.0, -20.0, 30.0])
    places = np.array([STANDARD.place(middle, generator) for _ in range(N)])
    np.testing.assert_allclose(places.std(axis=0), 3.0, rtol=SD_SHARE)
    np.testing.assert_allclose(places.mean(axis=0), middle, atol=5.0 * 3.0 / np.sqrt(N))


def test_shifted_places_lie_at_their_distance_in_any_direction(
    generator: np.random.Generator,
) -> None:
    shifted = Conditions(shift_mm=6.0)
    ways = np.array([shifted.place(np.zeros(3), generator) for _ in range(N)])
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 6.0)
    # Each component of a random direction has the variance 1/3.
    np.testing.assert_allclose(ways.mean(axis=0), 0.0, atol=5.0 * 6.0 / np.sqrt(3.0 * N))


def test_an_error_of_a_mounting_is_common_to_a_flexion_angle(
    generator: np.random.Generator,
) -> None:
    flexion = np.repeat(np.arange(N, dtype=float), 2)
    errors = Conditions(remount_mm=0.3, remount_deg=0.6).remounting(flexion, generator)
    np.testing.assert_array_equal(errors[::2], errors[1::2])
    np.testing.assert_allclose(errors.std(axis=0), [0.3, 0.3, 0.3, 0.6, 0.6], rtol=SD_SHARE)
    shared = np.asarray(np.corrcoef(errors[::2].T))[np.triu_indices(5, 1)]
    np.testing.assert_allclose(shared, 0.0, atol=5.0 / np.sqrt(N))
    assert not STANDARD.remounting(flexion, generator).any()


def test_an_amplitude_is_the_length_of_its_numbers(generator: np.random.Generator) -> None:
    """The mean square of a length is the number of its parts, each of variance one."""
    for n, over in ((1, 1.0), (4, 1.0), (24, np.sqrt(24.0))):
        sizes = [TruncatedNormal(sd=2.0).size(generator, n=n, over=float(over)) for _ in range(N)]
        mean = np.mean(np.square(sizes)) * over**2 / (4.0 * n)
        assert mean == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (n * N)))


def test_no_amplitude_passes_the_end_on_its_own_side(generator: np.random.Generator) -> None:
    spread = TruncatedNormal(sd=10.0, lower=-2.0, upper=5.0)
    up = max(spread.size(generator) for _ in range(N))
    down = max(spread.size(generator, sign=-1.0) for _ in range(N))
    assert 4.5 < up <= 5.0
    assert 1.8 < down <= 2.0
    values = [spread.value(generator) for _ in range(N)]
    assert -2.0 <= min(values) < -1.9
    assert 4.9 < max(values) <= 5.0


def test_contact_of_a_case_has_an_exponent_of_its_range(protocol: Protocol) -> None:
    knee = reference_knee()
    found = [
        blind_case(
            knee,
            seed=seed,
            effect=None,
            protocol=protocol,
            conditions=Conditions(exponents=(1.0, 1.5)),
        )
        for seed in range(4)
    ]
    exponents = [x.truth.facts["contact_exponent"] for x in found]
    assert len(set(exponents)) == 4
    assert all(1.0 <= float(str(x)) <= 1.5 for x in exponents)
    usual = blind_case(knee, seed=0, effect=None, protocol=protocol)
    assert usual.truth.facts["contact_exponent"] == 1.25
    assert usual.truth.theta == found[0].truth.theta
    assert (usual.noise_free.coordinates != found[0].noise_free.coordinates).any()


def test_a_mounting_moves_the_data_and_not_the_knee(protocol: Protocol) -> None:
    knee = reference_knee()
    usual, mounted = (
        blind_case(knee, seed=3, effect=None, protocol=protocol, conditions=x)
        for x in (STANDARD, Conditions(remount_mm=0.3, remount_deg=0.3))
    )
    np.testing.assert_array_equal(usual.noise_free.coordinates, mounted.noise_free.coordinates)
    errors = mounted.laxity.coordinates - usual.laxity.coordinates
    assert np.abs(errors).max() == pytest.approx(mounted.truth.facts["largest_remounting"])
    # The data do not state that error: that is what the axis is about.
    np.testing.assert_array_equal(usual.laxity.sd, mounted.laxity.sd)


def test_the_prior_axes_have_the_spreads_that_the_library_states() -> None:
    """The defaults that README states: log-sd 0.35 and sd 2 %, in a box to 40 kN and 15 %."""
    knee = reference_knee()
    one, two = (conditions_of(x, knee) for x in (PRIOR, TWICE))
    assert (one.stiffness_log_sd, one.strain_sd_pct) == (0.35, 2.0)
    assert (two.stiffness_log_sd, two.strain_sd_pct) == (0.7, 4.0)
    assert (one.most_stiffness_kN, one.most_strain_pct) == (40.0, 15.0)
    assert set(one.amplitudes) == set(LISTED)
    for name, spread in one.amplitudes.items():
        assert two.amplitudes[name].sd == 2.0 * spread.sd
        assert two.amplitudes[name].upper == spread.upper


@pytest.mark.parametrize("axis", AXES)
def test_every_axis_gives_a_case(axis: str, protocol: Protocol) -> None:
    knee = reference_knee()
    case = blind_case(
        knee,
        seed=4,
        effect="anterolateral",
        protocol=protocol,
        conditions=conditions_of(axis, knee),
    )
    assert np.isfinite(case.laxity.coordinates).all()


def test_mistakes_of_the_caller() -> None:
    with pytest.raises(ValueError, match="greater than 0"):
        TruncatedNormal(sd=0.0)
    with pytest.raises(ValueError, match="lower < upper"):
        TruncatedNormal(sd=1.0, lower=1.0, upper=1.0)
    with pytest.raises(ValueError, match="farther apart"):
        TruncatedNormal(sd=1e-9, lower=1.0, upper=2.0).value(np.random.default_rng(0))
    with pytest.raises(ValueError, match="farther apart"):
        TruncatedNormal(sd=1e-9, lower=1.0, upper=2.0).size(np.random.default_rng(0))
    with pytest.raises(ValueError, match="exponents"):
        Conditions(exponents=(1.5, 1.0))
    with pytest.raises(ValueError, match="remount_mm"):
        Conditions(remount_mm=-1.0)
