"""Figures of a sample."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from problems import Linear, plain_parameters

from identknee.identify.posterior.posterior import Posterior, StopRule
from identknee.identify.posterior.sample import sample
from identknee.report.parameter_figures import (
    corner_figure,
    forces_figure,
    prior_posterior_figure,
)


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    """Of two parameters."""
    matrix = np.array([[2.0, 0.5], [0.0, 1.0]])
    problem = Linear(
        parameters=plain_parameters(2, -50.0, 50.0), matrix=matrix, data=np.array([1.0, -1.0])
    )
    return sample(problem, rule=StopRule(drift=np.inf), seed=1)


def test_every_figure_is_drawn(posterior: Posterior) -> None:
    names = ["ACL.stiffness_kN", "x"]
    draws = posterior.kept[tuple(posterior.independent(200).T)]
    truth = np.zeros(2)
    quantiles = np.sort(np.random.default_rng(0).normal(size=(3, 2, 5)), axis=2)
    figures = [
        prior_posterior_figure(names, posterior.prior, {"one": draws}, truth=truth),
        corner_figure(names, draws, truth=truth),
        forces_figure(["a", "b", "c"], ["ACL", "PCL"], quantiles, truth=np.zeros((3, 2))),
    ]
    for figure in figures:
        assert isinstance(figure, Figure)
        figure.canvas.draw()
    labels = [axes.get_xlabel() for axes in figures[0].axes]
    assert labels == ["ACL stiffness [kN]", "x"]
