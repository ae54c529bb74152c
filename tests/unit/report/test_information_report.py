"""Local geometry as datasets, summary and figures."""

import json

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
from identknee.report.information_groups import information_groups, information_summary
from identknee.runs.files import plain

Answer = tuple[Information, StructureCheck, tuple[Geodesic, Geodesic]]


@pytest.fixture(scope="module")
def answer() -> Answer:
    problem = sloppy_springs()
    return (
        information(problem, problem.minimum),
        check_structure(problem, n_points=8),
        geodesics(problem, problem.minimum),
    )


def test_datasets_name_parameters_and_directions(answer: Answer) -> None:
    groups = information_groups(*answer)
    assert set(groups) == {"fisher", "structure", "geodesic_0", "geodesic_1"}
    fisher = groups["fisher"]
    assert fisher["eigenvector"].sizes == {"parameter": 8, "direction": 8}
    matrix = fisher["information"].to_numpy()
    np.testing.assert_allclose(matrix, matrix.T)
    assert groups["structure"]["rank"].sizes == {"point": 8}
    for path, name in zip(answer[2], ("geodesic_0", "geodesic_1"), strict=True):
        assert groups[name].attrs["boundary"] == path.boundary.value
        assert groups[name]["theta"].shape == path.thetas.shape


def test_the_summary_is_json(answer: Answer) -> None:
    summary = json.loads(json.dumps(plain(information_summary(*answer)), allow_nan=False))
    assert summary["n_above_noise"] == 8
    assert len(summary["eigenvalues"]) == 8
    assert all(x["above_noise"] for x in summary["eigenvalues"])
    assert summary["structure"]["verdict"] == "full_rank"
    assert len(summary["geodesics"]) == 2
    assert len(summary["collinear"]) == 6
    assert summary["n_simulations"] > answer[0].n_simulations


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
    assert axes.get_yticklabels()[0].get_text() == "ACL.stiffness_kN"


def test_geodesics_have_a_column_each(answer: Answer) -> None:
    figure = geodesics_figure(answer[2])
    assert len(figure.axes) == 4
    for axes, path in zip(figure.axes, answer[2], strict=False):
        assert path.involved[0] in axes.get_title()
        legend = axes.get_legend()
        assert legend is not None
        assert len(legend.get_texts()) == 3
