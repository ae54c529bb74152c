"""Figures in a user's own axes, width and style, and with their numbers in a file beside them."""

import csv
import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from cli_runs import refused, run
from cycler import cycler
from figure_checks import RESULTS, stored_figures
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from report_folders import straight_profiles

import identknee as ik
from identknee.report.figures import (
    COLOURS,
    HEADS,
    LEAST_LETTERS,
    ONE_COLUMN_MM,
    TWO_COLUMNS_MM,
    figure_data,
    resize,
)
from identknee.report.parameter_figures import corner_figure

MM = 25.4
FREE = ("stiffness_kN", "reference_strain_pct")


def rows(figure: Figure) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(figure_data(figure))))


def test_a_value_that_was_not_measured_leaves_no_bar_among_the_numbers() -> None:
    figure = Figure()
    figure.subplots().errorbar([1.0, 2.0], [3.0, np.nan], yerr=[0.5, np.nan], fmt="o")
    bars = [(x["x"], x["y"]) for x in rows(figure) if x["mark"] == "interval"]
    assert bars == [("1", "2.5"), ("1", "3.5")]


def test_a_figure_of_one_panel_is_drawn_into_axes_that_are_given() -> None:
    own = Figure(layout="constrained")
    left, right = own.subplots(1, 2)
    made = ik.load(RESULTS / "information").plot("spectrum", ax=left)
    assert made is own
    assert left.lines
    assert "eigenvalue" in left.get_ylabel()
    assert not right.lines
    assert own.axes == [left, right]


def test_a_map_brings_its_bar_of_colours_along() -> None:
    own = Figure(layout="constrained")
    axes = own.subplots()
    ik.load(RESULTS / "information").plot("eigenvectors", ax=axes)
    assert axes.images
    assert len(own.axes) == 2


def test_several_panels_do_not_go_into_one_axes() -> None:
    answer = straight_profiles()
    own = Figure(layout="constrained")
    axes = own.subplots()
    with pytest.raises(ValueError, match=r"'profiles'.*subfigures"):
        answer.plot("profiles", ax=axes)
    assert not axes.has_data()
    # What failed leaves nothing behind.
    assert answer.plot("profiles") is not own


def test_several_panels_go_into_a_subfigure() -> None:
    answer = straight_profiles()
    own = Figure(layout="constrained")
    parts: Any = own.subfigures(2, 1)
    upper, lower = parts
    assert answer.plot("profiles", ax=upper) is own
    assert len(upper.axes) == 2
    assert not lower.axes
    assert ik.load(RESULTS / "fit").plot("laxity", ax=lower) is own
    assert lower.axes


@pytest.mark.parametrize("width_mm", [ONE_COLUMN_MM, TWO_COLUMNS_MM])
def test_a_width_is_kept_and_letters_stay_legible(width_mm: float) -> None:
    figure = straight_profiles().plot("intervals", width_mm=width_mm)
    assert figure.get_size_inches()[0] * MM == pytest.approx(width_mm)
    texts = [x for x in figure.findobj(Text) if x.get_text().strip()]
    assert min(float(x.get_fontsize()) for x in texts) >= LEAST_LETTERS - 1e-9
    whole = straight_profiles().plot("intervals")
    usual = {x.get_text(): float(x.get_fontsize()) for x in whole.findobj(Text)}
    for text in (x for x in texts if x.get_text() in usual):
        assert float(text.get_fontsize()) < usual[text.get_text()]


def test_a_width_in_which_texts_do_not_fit_is_refused_with_one_that_does() -> None:
    answer = ik.load(RESULTS / "simulate")
    with pytest.raises(ValueError, match=r" 30 mm; .* 89 mm"):
        answer.plot("laxity-all", width_mm=30.0)
    with pytest.raises(ValueError, match=r"width_mm\b.*\bax\b"):
        answer.plot("laxity", ax=Figure(), width_mm=89.0)


def test_colours_and_paper_are_those_of_the_style() -> None:
    answer = straight_profiles()
    usual = {to_hex(x.get_color()) for x in answer.plot("intervals").axes[0].lines}
    assert COLOURS[0].lower() in usual
    colours = cycler(color=["#123456", "#654321"])
    style: dict[Any, Any] = {"axes.prop_cycle": colours, "text.color": "#fafafa"}
    style |= {"figure.facecolor": "#000000", "axes.facecolor": "#000000"}
    with mpl.rc_context(style):
        figure = answer.plot("intervals")
    styled = {to_hex(x.get_color()) for x in figure.axes[0].lines}
    assert "#123456" in styled
    assert not styled & {x.lower() for x in COLOURS}
    assert to_hex(figure.patch.get_facecolor()) == "#000000"
    assert to_hex(figure.axes[0].patch.get_facecolor()) == "#000000"
    assert {to_hex(x.get_color()) for x in figure.axes[0].texts} == {"#fafafa"}


@pytest.mark.parametrize("form", ["svg", "pdf"])
def test_text_stays_text_where_a_user_saves_a_figure(form: str) -> None:
    buffer = io.BytesIO()
    straight_profiles().plot("intervals").savefig(buffer, format=form)
    wanted = b"<text" if form == "svg" else b"/FontFile2"
    assert wanted in buffer.getvalue()


def test_what_a_knee_carries_is_drawn_on_its_own_and_into_a_subfigure() -> None:
    answer = ik.load(RESULTS / "fit")
    figure = answer.plot("all-forces", width_mm=TWO_COLUMNS_MM)
    titles = {x.get_title() for x in figure.axes}
    assert {"ACL", "PCL", "LCL", "MCL", "medial contact", "lateral contact"} <= titles
    whole = Figure(figsize=(12.0, 12.0), layout="constrained")
    parts: Any = whole.subfigures(2, 1)
    upper, lower = parts
    assert answer.plot("knee-loads", ax=upper) is whole
    assert any(x.collections for x in upper.axes)
    assert not lower.axes


def test_a_knee_that_is_not_that_of_the_result_is_not_drawn() -> None:
    answer = ik.load(RESULTS / "fit")
    other = ik.example("lenhart2015")
    with pytest.raises(ValueError, match=r"changed since.* knee="):
        answer.plot("knee-loads", knee=other)
    with pytest.raises(ValueError, match=r"'knee'; .*\ball-forces\b"):
        answer.plot("knee")
    with pytest.raises(ValueError, match=r"'knee-loads'; .*\bspectrum, "):
        ik.load(RESULTS / "information").plot("knee-loads")


@pytest.mark.slow
def test_a_corner_of_eight_parameters_has_the_width_of_two_columns() -> None:
    names = [f"{x}.{y}" for x in ("ACL", "PCL", "LCL", "MCL") for y in FREE]
    draws = np.random.default_rng(1).normal(size=(200, len(names)))
    figure = corner_figure(names, draws)
    resize(figure, TWO_COLUMNS_MM)
    assert figure.get_size_inches()[0] * MM == pytest.approx(TWO_COLUMNS_MM)


def test_a_table_beside_a_figure_has_its_numbers() -> None:
    answer = straight_profiles()
    found = rows(answer.plot("profiles"))
    for profile in answer.parameters.values():
        own = [x for x in found if x["mark"] == "points" and profile.unit in x["panel"]]
        shown = {(float(x["x"]), float(x["y"])) for x in own}
        for point in zip(profile.values.tolist(), profile.deltas.tolist(), strict=True):
            assert any(np.allclose(x, point) for x in shown)
    thresholds = {float(x["y"]) for x in found if x["mark"] == "threshold"}
    assert any(np.isclose(x, profile.threshold) for x in thresholds)
    bars = rows(answer.plot("intervals"))
    assert {x["y_word"] for x in bars} >= {"x1 value"}
    assert {x["series"] for x in bars} >= {"95 %", "best fit"}


def test_the_cells_of_a_map_have_their_values_and_words() -> None:
    answer = ik.load(RESULTS / "information")
    assert isinstance(answer, ik.LocalIdentifiability)
    cells = [x for x in rows(answer.plot("eigenvectors")) if x["mark"] == "cell"]
    shown = np.array([float(x["value"]) for x in cells])
    assert shown == pytest.approx(answer.fisher.eigenvectors.ravel())
    assert {x["y_word"] for x in cells} == {
        f"{x.partition('.')[0]} {'stiffness' if 'stiffness' in x else 'reference strain'}"
        for x in answer.fisher.parameter_names
    }


@pytest.mark.parametrize("verb", sorted(x.name for x in RESULTS.iterdir() if x.name != "check"))
def test_every_figure_of_a_stored_result_has_numbers(verb: str) -> None:
    for name, drawing in stored_figures(verb).drawings.items():
        found = rows(drawing.figure)
        assert list(found[0]) == list(HEADS), name
        assert any(x["x"] and x["y"] for x in found), name


def test_the_command_writes_them_beside_each_other(tmp_path: Path) -> None:
    out = ("--out", tmp_path / "page.html")
    figures = ("--figures", "svg", "--data", "csv", "--width", "183")
    result = run("report", RESULTS / "information", *out, *figures)
    assert result.exit_code == 0, result.output
    names = sorted(x.name for x in (tmp_path / "figures").iterdir())
    assert names == [
        *("information-eigenvectors.csv", "information-eigenvectors.svg"),
        *("information-spectrum.csv", "information-spectrum.svg"),
    ]
    width = 183 / MM * 72
    assert f'width="{width:.6f}'[:10] in (tmp_path / "figures" / names[1]).read_text("utf-8")
    assert "add --figures" in refused("report", RESULTS / "information", *out, "--data", "csv")
    narrow = ("--figures", "svg", "--width", "20")
    said = refused("report", RESULTS / "information", *out, *narrow)
    assert said.startswith("information-spectrum: ")
    assert " 20 mm" in said
