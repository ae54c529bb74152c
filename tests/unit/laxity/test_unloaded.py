from dataclasses import replace

import numpy as np
import pytest

from identknee.laxity.protocol import Protocol, from_zero, load_protocol, unloaded_trials
from identknee.laxity.table import Laxity, relative_to_unloaded


def example() -> Laxity:
    """Loaded and twice unloaded at about 30 deg, loaded and unloaded at 60."""
    loads = np.zeros((5, 5))
    loads[[0, 3], 1] = 5
    protocol = Protocol(
        name="mine",
        trials=tuple("abcde"),
        flexion_deg=np.array([30.2, 30, 29.9, 60, 60]),
        loads=loads,
    )
    coordinates = np.array([[7.0], [1], [2], [9], [4]]) * np.ones(5)
    return Laxity(protocol=protocol, coordinates=coordinates)


def test_changes_are_counted_from_the_mean_unloaded_pose_of_the_angle() -> None:
    relative = relative_to_unloaded(example())
    assert relative.zero == "unloaded"
    assert relative.coordinates[:, 0].tolist() == [5.5, -0.5, 0.5, 5, 0]
    assert relative_to_unloaded(relative) is relative


def test_changes_from_the_opposite_trial_have_no_unloaded_pose() -> None:
    blank = np.full((9, 5), np.nan)
    laxity = Laxity(protocol=load_protocol("drawer"), coordinates=blank, zero="opposite")
    with pytest.raises(ValueError, match="absolute coordinates"):
        relative_to_unloaded(laxity)


def test_the_same_for_arrays_of_any_depth() -> None:
    laxity = example()
    deep = np.repeat(laxity.coordinates[:, :, None], 3, axis=2)
    expected = relative_to_unloaded(laxity).coordinates
    plain = from_zero(laxity.coordinates, laxity.protocol, "unloaded")
    np.testing.assert_array_equal(plain, expected)
    np.testing.assert_array_equal(from_zero(deep, laxity.protocol, "unloaded")[:, :, 1], expected)


def test_a_replicate_not_measured_is_left_out_of_the_mean() -> None:
    laxity = example()
    coordinates = np.array(laxity.coordinates)
    coordinates[1, 0] = coordinates[4, 0] = np.nan
    relative = relative_to_unloaded(replace(laxity, coordinates=coordinates))
    np.testing.assert_array_equal(relative.coordinates[:, 0], [5, np.nan, 0, np.nan, np.nan])
    assert relative.coordinates[3, 1] == 5


def test_spread_of_a_difference_adds_up() -> None:
    sd = np.full((5, 5), 0.3)
    sd[:, 4] = np.nan
    relative = relative_to_unloaded(replace(example(), sd=sd))
    assert relative.sd is not None
    # Two replicates halve the variance of the zero at 30 deg.
    expected = [0.3 * np.sqrt(1.5), 0.3, 0.3, 0.3 * np.sqrt(2), 0.3]
    np.testing.assert_allclose(relative.sd[:, 0], expected, rtol=1e-14)
    assert np.isnan(relative.sd[:, 4]).all()


def test_an_angle_without_an_unloaded_trial_is_named() -> None:
    seed63 = load_protocol("seed63")
    lacking = seed63.select(~seed63.is_unloaded | (seed63.flexion_deg != 30))
    with pytest.raises(ValueError, match=r"'seed63'.*unloaded.*30"):
        unloaded_trials(lacking)
