"""Figures of equivalent sets."""

import numpy as np

from identknee.report.figures import png
from identknee.report.parameter_figures import ranges_figure, sets_figure


def test_figures_are_drawn() -> None:
    generator = np.random.default_rng(0)
    sets = generator.normal(size=(6, 3))
    names = ["ACL.stiffness_kN", "ACL.reference_strain_pct", "offset"]
    laxity = {"varus [deg]": generator.normal(size=(6, 9))}
    figure = sets_figure(names, sets, sets.mean(axis=0), laxity)
    assert len(figure.axes) == 2
    assert figure.axes[0].get_xticklabels()[1].get_text() == "ACL\nreference\nstrain [%]"
    assert png(figure)
    ranges = {"noise": np.array([[0.0, 2.0], [1.0, 5.0]]), "paper": np.array([[0.0, 3.0], [0, 9]])}
    bars = ranges_figure(["first", "second"], np.array([1.0, 2.0]), ranges, unit="tension [N]")
    widths = [patch.get_width() for patch in bars.axes[0].patches]  # type: ignore[attr-defined]
    assert widths == [2.0, 4.0, 3.0, 9.0]
    assert bars.axes[0].get_xlabel() == "tension [N]"
