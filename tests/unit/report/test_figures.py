from dataclasses import replace

import numpy as np
import pytest
from common.paper_figures import (
    error_figure,
    evaluation_figure,
    force_strain_figure,
    margin_figure,
    parameters_figure,
    profile_figure,
)
from common.published import TABLE2
from matplotlib.figure import Figure

from identknee.report.figures import png, vector

TRUTH = np.array([10.0, 18.0, 8.0, -4.0])
STARTS = ("IG1", "IG4")
ENDS = {
    knee: {
        start: TRUTH + np.random.default_rng(seed).normal(size=(3, 4))
        for seed, start in enumerate(STARTS)
    }
    for knee in ("one", "two")
}


def _figures() -> dict[str, Figure]:
    angles = np.repeat([0.0, 30.0], 3)
    moments = np.stack([np.tile([-2.0, 0.0, 2.0], 2), np.zeros(6)], axis=1)
    load = np.linspace(-2.0, 2.0, 5)
    broken = np.where(load > 1.0, np.nan, 3.0 * load)
    return {
        "evaluation": evaluation_figure(TABLE2, {"a": np.arange(13.0), "b": np.full(13, np.nan)}),
        "profile": profile_figure({"one": (angles, moments, 3.0 * moments)}),
        "parameters": parameters_figure(["ACL", "PCL"], TRUTH, {"IG1": TRUTH, "IG4": TRUTH}, ENDS),
        "errors": error_figure(
            {k: {s: np.ones((2, 2)) for s in STARTS} for k in ENDS},
            {"IG1": (0.1, 0.2), "IG4": (3.0, 1.0)},
        ),
        "force": force_strain_figure(["ACL", "PCL"], TRUTH, ENDS),
        "margin": margin_figure([("0 deg", {"one": (load, broken, np.abs(broken))})]),
    }


@pytest.mark.parametrize(
    "name", ["evaluation", "profile", "parameters", "errors", "force", "margin"]
)
def test_every_figure_draws_without_a_warning(name: str) -> None:
    # Warnings are errors in this suite.
    assert png(_figures()[name]).startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["profile", "parameters", "errors", "force", "margin"])
def test_units_stand_on_the_axes(name: str) -> None:
    figure = _figures()[name]
    labels = [x.get_ylabel() for x in figure.axes]
    assert any("[" in label and "]" in label for label in labels)


def test_force_curve_of_the_truth_follows_equation_3() -> None:
    figure = force_strain_figure(["ACL"], [10.0, 8.0], {"k": {"IG1": np.array([[10.0, 8.0]])}})
    line = next(x for x in figure.axes[0].lines if x.get_label() == "true")
    elongation, tension = (np.asarray(x, float) for x in line.get_data())
    strain = (1.0 + elongation / 100.0) * 1.08 - 1.0
    expected = np.where(
        strain > 0.06, 1e4 * (strain - 0.03), 1e4 * np.maximum(strain, 0.0) ** 2 / 0.12
    )
    np.testing.assert_allclose(tension, expected, rtol=1e-12, atol=1e-9)


def test_margin_figure_marks_where_a_curve_ends() -> None:
    figure = _figures()["margin"]
    marks = [x for x in figure.axes[0].lines if x.get_marker() == "X"]
    assert [float(np.asarray(x.get_xdata()).ravel()[0]) for x in marks] == [1.0]


def test_measured_row_keeps_its_place() -> None:
    row = replace(TABLE2[0], mean=1.0)
    figure = evaluation_figure([row], {})
    assert figure.axes[0].get_yticklabels()[0].get_text() == "anterior force 134 N, 30 deg"


@pytest.mark.filterwarnings("error")
def test_names_are_written_letter_by_letter() -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.set_xscale("log")
    axes.plot([1.0, 1000.0], [0.0, 1.0], label="$x^$")
    axes.set_title("knee $ \u9aa8")
    axes.legend()
    for _ in range(2):
        text = vector(figure, "svg").decode()
        assert ">$x^$<" in text
        assert ">knee $ \u9aa8<" in text
        # The labels of the logarithmic axis are formulas still.
        assert "mathdefault" in text
        assert ">$\\mathdefault" not in text
    assert png(figure).startswith(b"\x89PNG")
