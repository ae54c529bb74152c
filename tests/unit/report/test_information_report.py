"""Figures of local geometry."""

import numpy as np
import pytest
from problems import sloppy_springs

from identknee.identify.information import Information, information
from identknee.report.parameter_figures import (
    eigenvectors_figure,
    spectrum_figure,
)


@pytest.fixture(scope="module")
def answer() -> Information:
    problem = sloppy_springs()
    return information(problem, problem.minimum)


def test_the_spectrum_stands_above_its_floors(answer: Information) -> None:
    figure = spectrum_figure({"springs": answer, "again": answer})
    axes = figure.axes[0]
    assert axes.get_yscale() == "log"
    assert "8 of 8 " in axes.texts[0].get_text()
    assert [x.get_text() for x in axes.get_xticklabels()] == ["springs", "again"]


def test_the_eigenvectors_name_their_shares(answer: Information) -> None:
    figure = eigenvectors_figure(answer)
    axes = figure.axes[0]
    large = int((np.abs(answer.eigenvectors) >= 0.1).sum())
    assert len(axes.texts) == large
    assert axes.get_yticklabels()[0].get_text() == "ACL stiffness"
