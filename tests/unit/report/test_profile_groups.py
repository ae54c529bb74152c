"""Profiles as datasets, words and figures."""

import json

import numpy as np
import pytest
import xarray
from problems import ClosedForm, linear, plain_parameters

from identknee.calibrate.problem import with_bounds
from identknee.identify.profile.pairs import PairProfile, profile_pair
from identknee.identify.profile.profiles import profile_parameters
from identknee.identify.profile.result import Profile
from identknee.report.picture import png
from identknee.report.profile_figures import (
    intervals_figure,
    pairs_figure,
    paths_figure,
    profiles_figure,
)
from identknee.report.profile_groups import (
    LEVELS,
    nested,
    pair_summary,
    profile_groups,
    profile_summary,
)
from identknee.runs.files import plain

NAMES = ("x0.value_pct", "x1.value_pct")


@pytest.fixture(scope="module")
def profiles() -> tuple[Profile, ...]:
    """Three closed ones, and one with an open end and two wells."""
    problem = linear()
    cut = with_bounds(problem, {"x0.value_pct": (-10.0, problem.minimum[0] + 0.1)})
    return (
        *profile_parameters(problem, problem.minimum),
        *profile_parameters(cut, problem.minimum, ["x0.value_pct"]),
    )


@pytest.fixture(scope="module")
def wells() -> Profile:
    problem = ClosedForm(
        name="wells",
        parameters=plain_parameters(1),
        start=np.zeros(1),
        minimum=np.array([2.0]),
        lowest=0.0,
        residuals_at=lambda x: x**2 - 4,
        jacobian_at=lambda x: np.array([[2 * x[0]]]),
    )
    return profile_parameters(problem, problem.minimum)[0]


@pytest.fixture(scope="module")
def pair() -> PairProfile:
    problem = linear()
    return profile_pair(problem, problem.minimum, NAMES)


def test_groups_hold_curves_and_sets(profiles: tuple[Profile, ...], pair: PairProfile) -> None:
    names = linear().parameters.names
    groups = profile_groups(profiles, names, [pair])
    assert set(groups) == {"profile", "ci", "profile_pairs"}
    curves, sets = groups["profile"], groups["ci"]
    first = profiles[0]
    n = len(first.values)
    np.testing.assert_array_equal(curves["value"][0, :n], first.values)
    assert np.isnan(curves["value"][0, n:]).all()
    np.testing.assert_array_equal(curves["z"][0, :n], first.z)
    assert curves["theta"].dims == ("quantity", "point", "parameter")
    np.testing.assert_allclose(
        2.0 * curves["nll"][0, :n] - first.deviance, first.deltas, atol=1e-12
    )
    assert sets["upper_open"].values.tolist() == [False, False, False, True]
    assert np.isnan(sets["upper"][3])
    assert sets["upper_status"].values[3] == "open_at_bound"
    assert groups["profile_pairs"].sizes["ray"] == len(pair.rays)
    tree = xarray.DataTree.from_dict(groups)
    assert "profile" in tree.children


def test_nested_sets_lie_in_one_another(profiles: tuple[Profile, ...]) -> None:
    widths = []
    for ((low, high),) in nested(profiles[0]).values():
        assert low is not None
        assert high is not None
        widths.append(high - low)
    assert len(widths) == len(LEVELS) + 1
    assert widths == sorted(widths)


def test_the_summary_has_null_for_an_open_end(profiles: tuple[Profile, ...]) -> None:
    words = json.loads(json.dumps(plain(profile_summary(profiles[3]))))
    assert words["upper"] is None
    assert words["upper_status"] == "open_at_bound"
    assert words["verdict"] == "one_sided"
    assert words["sentence"].startswith("The data bound the value on one side")
    assert words["intervals"][0][1] is None
    assert words["n_simulations"] > 0


def test_a_pair_has_a_summary(pair: PairProfile) -> None:
    words = plain(pair_summary(pair))
    assert len(words["edge"]) == len(pair.rays)
    assert set(words["statuses"]) == {"closed"}


def test_every_figure_is_drawn(
    profiles: tuple[Profile, ...], wells: Profile, pair: PairProfile
) -> None:
    """One panel a profile; two wells and open ends have their marks."""
    everything = (*profiles, wells)
    figure = profiles_figure(everything)
    assert sum(x.get_visible() for x in figure.axes) == len(everything)
    assert any(text.get_text() == "open" for x in figure.axes for text in x.texts)
    drawn = [
        figure,
        paths_figure(profiles[:3], linear().parameters),
        intervals_figure(everything),
        pairs_figure([pair]),
    ]
    for one in drawn:
        assert png(one).startswith(b"\x89PNG")
