import numpy as np
import pytest
from common.largest import largest_by
from common.spreads import spread

from identknee.laxity.protocol import load_protocol
from identknee.laxity.trial_words import load_scenarios
from identknee.verbs.demo import parameter_error

REFERENCE = [10.0, 18.0, 6.0, 8.3, 8.0, -4.0, 2.0, 4.0]
IG4 = [8.0, 8.0, 8.0, 8.0, 4.0, 4.0, 4.0, 4.0]


def test_distance_of_ig4_is_what_table_1_of_the_paper_prints() -> None:
    error = parameter_error(IG4, REFERENCE)
    assert error.stiffness_kN == pytest.approx([2.0, 10.0, 2.0, 0.3])
    assert round(error.mean_kN, 1) == 3.6
    assert error.mean_pct == pytest.approx(3.5)


@pytest.mark.parametrize("theta", [[1.0, 2.0, 3.0], [[1.0, 2.0], [3.0, 4.0]]])
def test_parameters_must_come_in_pairs(theta: list[float] | list[list[float]]) -> None:
    with pytest.raises(ValueError, match=r"stiffness.*strain"):
        parameter_error(theta, theta)


def test_scenarios_of_the_paper_are_told_apart() -> None:
    seed, drawer = load_protocol("seed63"), load_protocol("drawer")
    counts = {x: load_scenarios(seed).count(x) for x in load_scenarios(seed)}
    assert counts == {
        "valgus moment": 15,
        "varus moment": 15,
        "external moment": 15,
        "internal moment": 15,
        "unloaded": 3,
    }
    assert sorted(set(load_scenarios(drawer))) == ["anterior force", "posterior force", "unloaded"]


def test_largest_by_leaves_out_what_is_not_a_number() -> None:
    values = np.array([[1.0, np.nan], [3.0, np.nan], [np.nan, 5.0], [9.0, 9.0]])
    table = largest_by(values, ["a", "a", "b", "c"], ["a", "b", "none"])
    np.testing.assert_array_equal(table, [[3.0, np.nan], [np.nan, 5.0], [np.nan, np.nan]])


def test_spread_has_the_median_the_range_and_an_interval_within_it() -> None:
    values = np.random.default_rng(3).normal(5.0, 1.0, 20)
    found = spread([*values, np.nan, np.inf])
    assert found.n == 20
    assert found.median == np.median(values)
    assert (found.low, found.high) == (values.min(), values.max())
    assert found.low < found.ci_low < found.median < found.ci_high < found.high
    assert spread(values) == found


def test_spread_of_nothing_is_empty() -> None:
    found = spread([np.nan])
    assert found.n == 0
    assert np.isnan(found.median)
