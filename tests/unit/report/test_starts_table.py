"""Fits from several starts beside the truth: rows, table, dataset and figure."""

from collections.abc import Sequence

import numpy as np
import pytest

from identknee.calibrate.fit import Fit
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.report.picture import png
from identknee.report.starts import StartRow, start_row, starts_dataset, starts_table
from identknee.report.starts_figure import starts_figure
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome
from identknee.subject.reference import reference_knee


@pytest.fixture(scope="module")
def model() -> LaxityModel:
    return LaxityModel(knee=reference_knee(), protocol=load_protocol("seed63").select([0, 5, 10]))


def a_fit(model: LaxityModel, theta: Array, method: str = "complex") -> Fit:
    return Fit(
        method=method,
        parameters=model.parameters,
        fixed=(),
        priors=False,
        start=model.parameters.center,
        theta=theta,
        objective=1.0,
        outcome=Outcome.SPREAD,
        message="",
        n_simulations=100,
        budget=2500,
        seconds=2.0,
        seed=0,
        history=np.array([[1.0, 1.0]]),
        gradient_norm=None,
    )


def rows(model: LaxityModel, shifts: Sequence[float]) -> list[StartRow]:
    """A row for each method; run i has all stiffnesses off by a shift [kN]."""
    truth, laxity = model.parameters.center, model.simulate(model.parameters.center)
    off = np.r_[np.ones(4), np.zeros(4)]
    return [
        start_row(
            "IG4", [a_fit(model, truth + x * off, method) for x in shifts], truth, model, laxity
        )
        for method in ("complex", "least-squares")
    ]


def test_errors_are_means_over_the_ligaments(model: LaxityModel) -> None:
    (row, _) = rows(model, [0.0, 0.5, -0.75])
    np.testing.assert_allclose(row.error_kN, [0.0, 0.5, 0.75], rtol=1e-12)
    np.testing.assert_array_equal(row.error_pct, 0.0)
    assert row.rmse_mm[0] == row.rmse_deg[0] == 0.0
    assert (row.rmse_deg[1:] > 0.0).all()


def test_the_summary_is_of_medians(model: LaxityModel) -> None:
    summary = rows(model, [0.0, 0.5, 0.75])[0].to_dict()
    assert summary["error"]["kN"] == pytest.approx(0.5)
    assert summary["outcomes"] == {"spread": 3}
    assert (summary["n_runs"], summary["n_simulations"]) == (3, 100)


def test_the_table_has_a_line_a_row_in_straight_columns(model: LaxityModel) -> None:
    head, *lines = starts_table(rows(model, [0.5, 1e-9]))
    assert len(lines) == 2
    assert "0.25 kN" in lines[0]
    assert lines[0].index("2.00  spread 2") == lines[1].index("2.00  spread 2")
    assert head.index("ended") == lines[0].index("spread 2")


def test_the_dataset_holds_every_run(model: LaxityModel) -> None:
    data = starts_dataset(rows(model, [0.0, 0.5]))
    assert data.sizes == {"fit": 4, "parameter": 8}
    assert data["method"].values.tolist() == ["complex"] * 2 + ["least-squares"] * 2


def test_the_figure_has_a_dot_for_every_run(model: LaxityModel) -> None:
    figure = starts_figure(starts_dataset(rows(model, [0.0, 0.5])))
    for axes in figure.axes:
        dots = [line for line in axes.lines if line.get_label() in ("complex", "least-squares")]
        assert [len(np.asarray(line.get_xdata())) for line in dots] == [2, 2]
    assert png(figure).startswith(b"\x89PNG")
