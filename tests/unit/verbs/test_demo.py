"""Fits from several starts beside the truth: errors, figure and words."""

from collections.abc import Sequence

import numpy as np
import pytest

from identknee.calibrate.fit import Fit
from identknee.laxity.protocol import load_protocol
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.report.answers.demo import least_squares_sentence
from identknee.report.figures import png
from identknee.report.sweep_figures import starts_figure
from identknee.runs.declare import Array
from identknee.runs.record import Outcome
from identknee.subject.reference import reference_knee
from identknee.verbs.demo import StartFits, start_fits


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


def rows(model: LaxityModel, shifts: Sequence[float]) -> list[StartFits]:
    """A row for each method; run i has all stiffnesses off by a shift [kN]."""
    truth = model.parameters.center
    problem = LaxityResiduals(model=model, laxity=model.simulate(truth))
    off = np.r_[np.ones(4), np.zeros(4)]
    return [
        start_fits("IG4", [a_fit(model, truth + x * off, method) for x in shifts], truth, problem)
        for method in ("complex", "least-squares")
    ]


def test_errors_are_means_over_the_ligaments(model: LaxityModel) -> None:
    (row, _) = rows(model, [0.0, 0.5, -0.75])
    np.testing.assert_allclose(row.error_kN, [0.0, 0.5, 0.75], rtol=1e-12)
    np.testing.assert_array_equal(row.error_pct, 0.0)
    assert row.rmse_mm[0] == row.rmse_deg[0] == 0.0
    assert (row.rmse_deg[1:] > 0.0).all()


def test_the_summary_is_of_medians(model: LaxityModel) -> None:
    row = rows(model, [0.0, 0.5, 0.75])[0]
    assert row.error["kN"] == pytest.approx(0.5)
    assert row.outcomes == {"spread": 3}
    assert (row.n_runs, row.n_simulations) == (3, 100)


def test_the_figure_has_a_dot_for_every_run(model: LaxityModel) -> None:
    figure = starts_figure(rows(model, [0.0, 0.5]))
    for axes in figure.axes:
        dots = [line for line in axes.lines if line.get_label() in ("complex", "least-squares")]
        assert [len(np.asarray(line.get_xdata())) for line in dots] == [2, 2]
    assert png(figure).startswith(b"\x89PNG")


def test_least_squares_that_missed_says_by_how_much(model: LaxityModel) -> None:
    missed, exact = (rows(model, [x])[1] for x in (0.5, 0.0))
    said = least_squares_sentence([exact, missed])
    assert "0.5 kN" in said
    assert "all 2 starts" in least_squares_sentence([exact, exact])
