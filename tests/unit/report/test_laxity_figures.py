"""Laxity along load curves: what is drawn is what is given."""

import numpy as np
from figure_checks import clipped, empty_axes, overlapping
from figure_checks import drawn as drawn_by
from report_folders import few_trials

from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, example_laxity
from identknee.report.figures import vector
from identknee.report.laxity_figures import (
    LaxityCurves,
    all_coordinates_figure,
    along_load_figure,
    by_flexion_figure,
)

INTERNAL = COORDINATES.index("internal_deg")


def curves(*, band: bool = False) -> LaxityCurves:
    protocol = few_trials()
    values = np.arange(protocol.n * 5.0).reshape(-1, 5)
    return LaxityCurves(
        protocol=protocol,
        simulated={"fit": values},
        measured=values + 1.0,
        sd=np.full_like(values, 0.5),
        band=("all", np.array([values - 2.0, values + 2.0])) if band else None,
    )


def test_the_coordinate_along_the_load_is_drawn() -> None:
    given = curves()
    figure = along_load_figure(given)
    assert figure is not None
    axes = next(x for x in figure.axes if x.get_ylabel() == "internal [deg]")
    assert axes.get_xlabel() == "internal moment [N·m]"
    line = next(x for x in axes.lines if x.get_label() == "fit")
    load = given.protocol.loads[:, LOADS.index("internal_moment_Nm")]
    expected = {
        (float(a), float(b))
        for a, b, other in zip(
            load, given.simulated["fit"][:, INTERNAL], given.protocol.loads[:, 1], strict=True
        )
        if other == 0.0
    }
    assert set(zip(*(np.asarray(x).tolist() for x in line.get_data()), strict=True)) == expected


def test_a_band_has_its_name() -> None:
    figure = along_load_figure(curves(band=True))
    assert figure is not None
    (legend,) = figure.legends
    assert [x.get_text() for x in legend.get_texts()] == ["all", "fit", "measured"]


def test_all_coordinates_have_a_row() -> None:
    figure = all_coordinates_figure(curves())
    assert figure is not None
    assert len(figure.axes) == 2 * len(COORDINATES)


def test_trials_that_make_no_curve_make_no_figure() -> None:
    protocol = Protocol(
        name="one", trials=("a",), flexion_deg=np.array([30.0]), loads=np.zeros((1, len(LOADS)))
    )
    lone = LaxityCurves(protocol=protocol, simulated={"fit": np.zeros((1, 5))})
    assert along_load_figure(lone) is None
    assert all_coordinates_figure(lone) is None


def test_a_figure_can_go_into_a_paper() -> None:
    for form, begins in (("svg", b"<?xml"), ("pdf", b"%PDF")):
        figure = along_load_figure(curves())
        assert figure is not None
        written = vector(figure, form)
        assert written.startswith(begins)
        # The same figure is the same file, whenever it is written.
        assert vector(figure, form) == written


def test_trials_without_load_curves_are_drawn_by_flexion() -> None:
    data = example_laxity("s192803")
    given = LaxityCurves(
        protocol=data.protocol,
        simulated={"fit": data.coordinates + 2.0},
        measured=data.coordinates,
    )
    assert along_load_figure(given) is None
    figure = by_flexion_figure(given)
    assert [x.get_ylabel() for x in figure.axes] == [
        *("lateral shift [mm]", "anterior drawer [mm]", "distraction [mm]"),
        *("varus [deg]", "internal [deg]"),
    ]
    for i, axes in enumerate(figure.axes):
        drawn = {x.get_label(): np.asarray(x.get_ydata()) for x in axes.lines}
        np.testing.assert_array_equal(drawn["fit"], data.coordinates[:, i] + 2.0)
        np.testing.assert_array_equal(drawn["measured"], data.coordinates[:, i])
    assert empty_axes(figure, renderer := drawn_by(figure)) == []
    assert clipped(figure, renderer) == []
    assert overlapping(figure, renderer) == []
