"""Figures of a sensitivity analysis."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from identknee.model.parameters import ligament_parameters
from identknee.report.parameter_figures import (
    effects_figure,
    map_figure,
)

PARAMETERS = ligament_parameters(["A", "new"], [1.0, 2.0], [3.0, 4.0])


def test_figures_are_drawn() -> None:
    values = np.array([0.5, 0.1, 0.0, 0.3])
    names = PARAMETERS.names
    panels = {"one": (values, 0.1 * values, values), "two": (values, values, 2.0 * values)}
    figures = [
        effects_figure(panels, names),
        map_figure(
            {"varus_deg": (["a", "b"], np.array([values, np.full(4, np.nan)]))}, names, "ST"
        ),
    ]
    assert all(isinstance(x, Figure) for x in figures)
    labels = [x.get_text() for x in figures[1].axes[0].get_xticklabels()]
    assert labels == ["A stiffness", "new stiffness", "A strain", "new strain"]
    # A single panel has the width of two, for the names in the legend.
    one = effects_figure({"one": panels["one"]}, names)
    assert len(one.axes) == 1
    assert one.get_figwidth() == figures[0].get_figwidth()


def test_effects_of_one_trajectory_are_drawn_without_spread() -> None:
    size, unknown = np.array([0.5, 0.1, 0.0, 0.3]), np.full(4, np.nan)
    axes = effects_figure({"one": (size, unknown, unknown)}, PARAMETERS.names).axes[0]
    assert axes.get_xlim() == pytest.approx((0.0, 0.56))
