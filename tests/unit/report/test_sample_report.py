"""Groups, summary and figures of a sample."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from problems import Cliff, Linear, linear, plain_parameters

from identknee.identify.posterior.convergence import StopRule
from identknee.identify.posterior.posterior import Posterior
from identknee.identify.posterior.power_scaling import prior_sensitivity
from identknee.identify.posterior.sample import sample
from identknee.report.sample_figures import (
    corner_figure,
    forces_figure,
    prior_posterior_figure,
    tau_figure,
    trace_figure,
)
from identknee.report.sample_groups import sample_groups, sample_summary


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    """Of two parameters."""
    matrix = np.array([[2.0, 0.5], [0.0, 1.0]])
    problem = Linear(
        parameters=plain_parameters(2, -50.0, 50.0), matrix=matrix, data=np.array([1.0, -1.0])
    )
    return sample(problem, rule=StopRule(drift=np.inf), seed=1)


def test_groups_keep_ensembles_walkers_and_steps_apart(posterior: Posterior) -> None:
    groups = sample_groups(posterior)
    theta = groups["posterior"]["theta"]
    n_ensembles, n_walkers, n_steps, n = posterior.kept.shape
    assert theta.shape == (n_ensembles * n_walkers, n_steps, n)
    for ensemble, walker in ((0, 0), (3, 5)):
        chain = (theta["ensemble"] == ensemble) & (theta["walker"] == walker)
        np.testing.assert_array_equal(
            theta[chain.to_numpy()].to_numpy()[0], posterior.kept[ensemble, walker]
        )
    lp = groups["sample_stats"]["lp"] - groups["log_prior"]["theta"]
    np.testing.assert_allclose(lp, groups["log_likelihood"]["laxity"], rtol=1e-9)
    assert groups["gate"].sizes["check"] == len(posterior.checks)


def test_arviz_reads_the_groups(posterior: Posterior) -> None:
    """Its functions of a dataset are the same in 0.23 and 1.x."""
    arviz = pytest.importorskip("arviz")
    theta = sample_groups(posterior)["posterior"]["theta"].to_numpy()
    for i in range(2):
        theirs = float(np.ravel(arviz.ess(theta[..., i]))[0])
        # It takes walkers for independent, and its truncation of the sum over lags differs.
        assert posterior.last_check.bulk[i].sum() == pytest.approx(theirs, rel=0.2)


def test_the_summary_has_the_keys_that_checks_read(posterior: Posterior) -> None:
    summary = sample_summary(posterior, prior_sensitivity(posterior))
    assert summary["outcome"] == "converged"
    assert summary["rhat_max"] <= 1.01
    assert summary["ess_min"] >= 400
    for name in posterior.parameters.names:
        one = summary["parameters"][name]
        assert one["q025"] < one["q500"] < one["q975"]
        assert {"mean", "sd", "mcse_mean", "tau", "leans_on"} <= set(one)


def test_without_a_sample_there_is_still_a_summary() -> None:
    nowhere = sample(Cliff(problem=linear(), beyond=lambda _: 1.0), seed=1)
    assert sample_summary(nowhere)["outcome"] == "start_failed"
    assert sample_summary(nowhere)["ess_min"] is None
    assert set(sample_groups(nowhere)) == {"prior", "gate"}


def test_every_figure_is_drawn(posterior: Posterior) -> None:
    names = ["ACL.stiffness_kN", "x"]
    draws = posterior.kept[tuple(posterior.independent(200).T)]
    tau = np.array([x.tau for x in posterior.checks])
    steps = [x.kept for x in posterior.checks]
    truth = np.zeros(2)
    quantiles = np.sort(np.random.default_rng(0).normal(size=(3, 2, 5)), axis=2)
    figures = [
        prior_posterior_figure(names, posterior.prior, {"one": draws}, truth=truth),
        corner_figure(names, draws, truth=truth),
        trace_figure(names, posterior.samples, posterior.last_check.burn_in),
        tau_figure(names, steps, tau),
        forces_figure(["a", "b", "c"], ["ACL", "PCL"], quantiles, truth=np.zeros((3, 2))),
    ]
    for figure in figures:
        assert isinstance(figure, Figure)
        figure.canvas.draw()
    labels = [axes.get_xlabel() for axes in figures[0].axes]
    assert labels == ["ACL stiffness [kN]", "x"]


def test_a_budget_that_ran_out_is_in_the_summary(posterior: Posterior) -> None:
    from identknee.identify.posterior.convergence import SampleOutcome

    stopped = replace(posterior, outcome=SampleOutcome.BUDGET)
    assert sample_summary(stopped)["sentence"] == SampleOutcome.BUDGET.sentence
