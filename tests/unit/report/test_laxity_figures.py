"""Laxity along load curves: what is drawn is what is given."""

from dataclasses import replace

import numpy as np
from figure_checks import clipped, empty_axes, overlapping
from figure_checks import drawn as drawn_by
from matplotlib.colors import to_rgba
from report_folders import few_trials

from identknee.laxity.protocol import LOADS, Protocol, concatenate, load_protocol
from identknee.laxity.table import COORDINATES, example_laxity
from identknee.report.figures import COLOURS, FIT, vector
from identknee.report.laxity_figures import (
    ALONG_GROUND,
    LOST,
    LaxityCurves,
    all_coordinates_figure,
    along_load_figure,
    by_load_figure,
)

WAYS_OF_DRAWER = ("Anterior", "Posterior")
INTERNAL = COORDINATES.index("internal_deg")


def wrapped_words(text: str) -> str:
    return text.replace("\n", " ")


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


def test_every_row_and_column_has_its_words_where_a_corner_is_empty() -> None:
    """Table 2 without drawer and internal moments at one angle: the first row begins further on."""
    protocol = load_protocol("table2")
    first = protocol.flexion_deg == np.unique(protocol.flexion_deg)[1]
    is_varus = protocol.loads[:, LOADS.index("varus_moment_Nm")] != 0.0
    is_loaded = (protocol.loads != 0.0).any(axis=1)
    protocol = protocol.select(np.flatnonzero(~first | is_varus | ~is_loaded))
    values = np.arange(protocol.n * 5.0).reshape(-1, 5)
    given = LaxityCurves(
        protocol=protocol, simulated={"fit": values}, measured=values, sd=np.ones_like(values)
    )
    figure = along_load_figure(given)
    assert figure is not None
    hidden = [x for x in figure.axes if not x.get_visible()]
    assert hidden
    columns: dict[float, list[str]] = {}
    rows: dict[float, list[str]] = {}
    figure.canvas.draw()
    for axes in figure.axes:
        if axes.get_visible():
            place = axes.get_subplotspec()
            assert place is not None
            columns.setdefault(place.colspan.start, []).append(axes.get_title())
            rows.setdefault(place.rowspan.start, []).append(axes.get_ylabel())
    for words in (*columns.values(), *rows.values()):
        assert sum(bool(x) for x in words) == 1


def test_the_coordinate_along_the_load_is_drawn() -> None:
    given = curves()
    figure = along_load_figure(given)
    assert figure is not None
    axes = next(x for x in figure.axes if x.get_ylabel() == "internal rotation [deg]")
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


def measured_knee() -> LaxityCurves:
    """A table as a rig writes it, beside a model that loses one trial."""
    data = example_laxity("s192803")
    fit = data.coordinates + 2.0
    fit[data.protocol.trials.index("Anterior_90")] = np.nan
    sd = np.full_like(fit, 0.5)
    return LaxityCurves(
        protocol=data.protocol, simulated={"fit": fit}, measured=data.coordinates, sd=sd
    )


def test_measured_trials_are_drawn_by_load_and_coordinate() -> None:
    given = measured_knee()
    on_curves, others = given.parts()
    (other,) = others.values()
    assert on_curves is None
    assert other.protocol.trials == given.protocol.trials
    figure = by_load_figure(other)
    panels = np.array(figure.axes).reshape(len(COORDINATES), 3)
    assert [wrapped_words(x.get_ylabel()) for x in panels[:, 0]] == [
        *("lateral shift [mm]", "anterior drawer [mm]", "distraction [mm]"),
        *("varus angulation [deg]", "internal rotation [deg]"),
    ]
    # Both directions of a load are in one panel, the trial without load in all.
    heads = [x.get_title(loc="left").splitlines() for x in panels[0]]
    assert heads == [
        ["● internal moment 7.53 N·m", "○ external moment 7.53 N·m", "× unloaded"],
        ["● varus moment 9.98 N·m", "○ valgus moment 9.7 N·m", "× unloaded"],
        ["● anterior force 197 N", "○ posterior force 204 N", "× unloaded"],
    ]
    assert [x.get_facecolor() == to_rgba(ALONG_GROUND) for x in panels[:, 2]] == [
        *(False, True, False, False, False)
    ]
    names = given.protocol.trials
    for column, ways in enumerate((("Internal", "External"), ("Varus", "Valgus"), WAYS_OF_DRAWER)):
        trials = [[i for i, x in enumerate(names) if x.startswith(way)] for way in ways]
        for row in range(len(COORDINATES)):
            drawn = panels[row, column].lines
            for own, line in zip(trials, [x for x in drawn if x.get_color() == FIT], strict=False):
                np.testing.assert_array_equal(line.get_ydata(), given.simulated["fit"][own, row])
    # What the model loses is marked where it was measured.
    drawer = panels[1, 2]
    lost = [x for x in drawer.lines if x.get_marker() == "x" and x.get_color() == COLOURS[1]]
    (place,) = [x for x in lost if len(np.asarray(x.get_xdata()))]
    assert given.measured is not None
    trial = names.index("Anterior_90")
    assert place.get_xdata() == [given.protocol.flexion_deg[trial]]
    assert place.get_ydata() == [given.measured[trial, 1]]
    assert [x.get_text() for x in drawer.texts] == ["RMSE 2.0 mm"]
    (legend,) = figure.legends
    assert [x.get_text() for x in legend.get_texts()] == ["fit", "measured ± 2 sd", LOST]
    assert empty_axes(figure, renderer := drawn_by(figure)) == []
    assert clipped(figure, renderer) == []
    assert overlapping(figure, renderer) == []


def test_each_state_has_its_own_figure_and_curves_theirs() -> None:
    data = example_laxity("s192803").protocol
    cut = replace(data, trials=tuple(f"{x}_cut" for x in data.trials), state=("cut: ACL",) * data.n)
    # Loads in steps at an angle that the rig reads a little otherwise in each trial.
    steps = Protocol(
        name="steps",
        trials=("a", "b", "c", "d"),
        flexion_deg=np.array([30.0, 30.2, 30.1, 30.3]),
        loads=np.array([[0.1, 0.0, x, -20.0, 0.0] for x in (-90.0, 1.0, 45.0, 90.0)]),
        state=("cut: LCL",) * 4,
    )
    whole = concatenate([data, cut, steps])
    values = np.zeros((whole.n, len(COORDINATES)))
    on_curves, others = LaxityCurves(protocol=whole, simulated={"fit": values}).parts()
    assert on_curves is not None
    assert on_curves.protocol.trials == steps.trials
    assert [x.protocol.trials for x in others.values()] == [data.trials, cut.trials]
    assert along_load_figure(on_curves) is not None
    assert [by_load_figure(x, k).get_suptitle() for k, x in others.items()] == [
        *("intact", "cut: ACL")
    ]
