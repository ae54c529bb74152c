"""Figures of profiles, and the nested sets in them."""

import numpy as np
import pytest
from problems import ClosedForm, linear, plain_parameters

from identknee.calibrate.problem import with_bounds
from identknee.identify.profile.profile import profile_parameters
from identknee.identify.profile.result import Profile
from identknee.report.figures import png
from identknee.report.parameter_figures import (
    LEVELS,
    intervals_figure,
    nested,
    profiles_figure,
)


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


def test_nested_sets_lie_in_one_another(profiles: tuple[Profile, ...]) -> None:
    widths = []
    for ((low, high),) in nested(profiles[0]).values():
        assert low is not None
        assert high is not None
        widths.append(high - low)
    assert len(widths) == len(LEVELS) + 1
    assert widths == sorted(widths)


def test_every_figure_is_drawn(profiles: tuple[Profile, ...], wells: Profile) -> None:
    """One panel a profile; two wells and open ends have their marks."""
    everything = (*profiles, wells)
    figure = profiles_figure(everything)
    assert sum(x.get_visible() for x in figure.axes) == len(everything)
    assert any(text.get_text() == "open" for x in figure.axes for text in x.texts)
    drawn = [
        figure,
        intervals_figure(everything),
    ]
    for one in drawn:
        assert png(one).startswith(b"\x89PNG")
