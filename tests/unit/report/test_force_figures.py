"""Measured forces beside predicted ones: what is drawn is what is given."""

import numpy as np
from figure_checks import clipped, drawn, overlapping
from matplotlib.container import ErrorbarContainer

from identknee.checks.fit_checks import ComparedForces
from identknee.report.laxity_figures import MOST_PANELS, MOST_TRIALS, compared_forces_figure


def _forces(kinds: list[str], n: int) -> ComparedForces:
    values = np.arange(float(n * len(kinds)))
    return ComparedForces(
        names=tuple(kind for kind in kinds for _ in range(n)),
        trials=tuple(f"trial{i}" for _ in kinds for i in range(n)),
        measured=values,
        sd=np.full(values.size, 2.0),
        predicted=values + 1.0,
    )


def test_each_kind_has_a_panel_with_bars_of_two_standard_deviations() -> None:
    figure = compared_forces_figure(_forces(["ACL.tension_N", "contact.medial_N"], 3))
    assert [x.get_xlabel() for x in figure.axes] == ["ACL tension [N]", "medial contact force [N]"]
    axes = figure.axes[1]
    assert [x.get_text() for x in axes.get_yticklabels()] == ["trial0", "trial1", "trial2"]
    predicted = next(x for x in axes.lines if x.get_label() == "predicted by the fit")
    np.testing.assert_array_equal(predicted.get_xdata(), [4.0, 5.0, 6.0])
    (bars,) = (x for x in axes.containers if isinstance(x, ErrorbarContainer))
    (segments,) = (x.get_segments() for x in bars[2])
    np.testing.assert_allclose([x[:, 0].tolist() for x in segments], [[-1, 7], [0, 8], [1, 9]])
    renderer = drawn(figure)
    assert not clipped(figure, renderer)
    assert not overlapping(figure, renderer)


def test_of_many_those_that_differ_most_are_shown() -> None:
    kinds = [f"L{i}.tension_N" for i in range(MOST_PANELS + 2)]
    forces = _forces(kinds, MOST_TRIALS + 3)
    away = np.array(forces.predicted)
    away[-1] += 50.0
    moved = ComparedForces(
        names=forces.names, trials=forces.trials, measured=forces.measured, sd=forces.sd,
        predicted=away,
    )  # fmt: skip
    figure = compared_forces_figure(moved)
    assert len(figure.axes) == MOST_PANELS
    assert figure.axes[-1].get_xlabel() == f"L{MOST_PANELS + 1} tension [N]"
    ticks = [x.get_text() for x in figure.axes[-1].get_yticklabels()]
    assert len(ticks) == MOST_TRIALS
    assert ticks[-1] == f"trial{MOST_TRIALS + 2}"
