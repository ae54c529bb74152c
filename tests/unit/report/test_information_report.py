"""Figures of local geometry."""

import numpy as np
import pytest
from problems import sloppy_springs

from identknee.identify.information.geodesic import Geodesic, geodesics
from identknee.identify.information.information import Information, information
from identknee.identify.information.structure import StructureCheck, check_structure
from identknee.report.information_figures import (
    eigenvectors_figure,
    geodesics_figure,
    spectrum_figure,
)

Answer = tuple[Information, StructureCheck, tuple[Geodesic, Geodesic]]


@pytest.fixture(scope="module")
def answer() -> Answer:
    problem = sloppy_springs()
    return (
        information(problem, problem.minimum),
        check_structure(problem, n_points=8),
        geodesics(problem, problem.minimum),
    )


def test_the_spectrum_stands_above_its_floors(answer: Answer) -> None:
    figure = spectrum_figure({"springs": answer[0], "again": answer[0]})
    axes = figure.axes[0]
    assert axes.get_yscale() == "log"
    assert "8 of 8 above noise" in axes.texts[0].get_text()
    assert [x.get_text() for x in axes.get_xticklabels()] == ["springs", "again"]


def test_the_eigenvectors_name_their_shares(answer: Answer) -> None:
    figure = eigenvectors_figure(answer[0])
    axes = figure.axes[0]
    large = int((np.abs(answer[0].eigenvectors) >= 0.1).sum())
    assert len(axes.texts) == large
    assert axes.get_yticklabels()[0].get_text() == "ACL stiffness"


def test_geodesics_have_a_column_each(answer: Answer) -> None:
    figure = geodesics_figure(answer[2])
    assert len(figure.axes) == 4
    for axes, path in zip(figure.axes, answer[2], strict=False):
        assert path.involved[0] in axes.get_title()
        legend = axes.get_legend()
        assert legend is not None
        assert len(legend.get_texts()) == 3
