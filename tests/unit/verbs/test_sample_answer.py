"""The answer of a sample: what it holds, and that files give it back."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from problems import Cliff, Linear, linear, plain_parameters
from report_folders import write_given

from identknee.identify.posterior.posterior import Posterior, SampleOutcome, StopRule
from identknee.identify.posterior.sample import sample
from identknee.model.parameters import Parameters
from identknee.report.printer import terminal_lines
from identknee.runs.declare import Array
from identknee.runs.findings import Finding, finding
from identknee.runs.schema import summary_of, to_plain
from identknee.verbs.files import groups_of, load
from identknee.verbs.identification import Identification
from identknee.verbs.sample import Nested, Sample, as_answer, at_best_fit

LOST = finding("no-prediction", "trials", sentence="no prediction")


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    """Of two parameters."""
    matrix = np.array([[2.0, 0.5], [0.0, 1.0]])
    problem = Linear(
        parameters=plain_parameters(2, -50.0, 50.0), matrix=matrix, data=np.array([1.0, -1.0])
    )
    return sample(problem, rule=StopRule(drift=np.inf), seed=1)


def nowhere() -> Sample:
    """Sampling that never began."""
    found = sample(Cliff(problem=linear(), beyond=lambda _: 1.0), seed=1)
    return as_answer(found, findings=(LOST,))


def test_files_give_the_answer_back(posterior: Posterior, tmp_path: Path) -> None:
    nested = Nested(
        log_evidence=-3.0,
        log_evidence_error=0.1,
        n_simulations=100,
        effective_draws=50.0,
        quantile_differences=np.full((2, 3), 0.5),
    )
    for k, answer in enumerate((as_answer(posterior, nested=nested), nowhere())):
        write_given(tmp_path / f"{k}", "sample", answer)
        again = load(tmp_path / f"{k}")
        assert isinstance(again, Sample)
        one, other = (to_plain(x) | {"record": None} for x in (answer, again))
        assert json.dumps(one) == json.dumps(other)
        assert terminal_lines(again) == terminal_lines(answer)


def test_groups_keep_ensembles_walkers_and_steps_apart(posterior: Posterior) -> None:
    groups = groups_of(as_answer(posterior))
    theta, stats = groups["posterior"]["theta"], groups["sample_stats"]
    n_ensembles, n_walkers, n_steps, n = posterior.kept.shape
    assert theta.shape == (n_ensembles * n_walkers, n_steps, n)
    for ensemble, walker in ((0, 0), (3, 5)):
        chain = (stats["ensemble"] == ensemble) & (stats["walker"] == walker)
        np.testing.assert_array_equal(
            theta[chain.to_numpy()].to_numpy()[0], posterior.kept[ensemble, walker]
        )
    lp = groups["sample_stats"]["lp"] - groups["log_prior"]["theta"]
    np.testing.assert_allclose(lp, groups["sample_stats"]["log_likelihood"], rtol=1e-9)
    assert groups["gate"].sizes["check"] == len(posterior.checks)


def test_arviz_reads_the_groups(posterior: Posterior) -> None:
    """Its functions of a dataset are the same in 0.23 and 1.x."""
    arviz = pytest.importorskip("arviz")
    theta = groups_of(as_answer(posterior))["posterior"]["theta"].to_numpy()
    for i in range(2):
        theirs = float(np.ravel(arviz.ess(theta[..., i]))[0])
        # It takes walkers for independent, and its truncation of the sum over lags differs.
        assert posterior.last_check.bulk[i].sum() == pytest.approx(theirs, rel=0.2)


def test_the_summary_has_the_keys_that_checks_read(posterior: Posterior) -> None:
    summary = summary_of(as_answer(posterior))
    assert summary["outcome"] == "converged"
    assert summary["rhat_max"] <= 1.01
    assert summary["ess_min"] >= 400
    for name in posterior.parameters.names:
        one = summary["parameters"][name]
        assert one["q025"] < one["q500"] < one["q975"]
        assert {"mean", "sd", "mcse_mean", "tau", "leans_on"} <= set(one)


def test_without_a_sample_there_is_still_a_summary() -> None:
    answer = nowhere()
    assert summary_of(answer)["outcome"] == "start_failed"
    assert summary_of(answer)["ess_min"] is None
    assert "posterior" not in groups_of(answer)
    assert answer.failure == "no prediction"


def test_a_budget_that_ran_out_is_in_the_summary(posterior: Posterior) -> None:
    stopped = replace(posterior, outcome=SampleOutcome.BUDGET)
    assert summary_of(as_answer(stopped))["sentence"] == SampleOutcome.BUDGET.sentence


@dataclass(frozen=True)
class TwoMinima:
    """A minimum of 0 where x is -1, and a higher one near 1."""

    parameters: Parameters = field(default_factory=lambda: plain_parameters(2, -50.0, 50.0))

    def residuals(self, theta: Array) -> Array:
        """Shape ``(3,)``."""
        x, y = theta
        return np.array([x**2 - 1.0, 0.3 * (x + 1.0), y + 1.0])

    def jacobian(self, theta: Array) -> Array:
        """Shape ``(3, 2)``."""
        return np.array([[2.0 * theta[0], 0.0], [0.3, 0.0], [0.0, 1.0]])


def test_the_best_fit_is_the_lowest_that_walkers_began_at_or_came_by(posterior: Posterior) -> None:
    """All draws lie beside the higher minimum."""
    looked_at: list[float] = []

    def findings_at(theta: Array, deviance: float) -> tuple[Finding, ...]:
        looked_at.extend([theta[0], deviance])
        return (LOST,)

    setup = SimpleNamespace(problem=TwoMinima(), findings_at=findings_at)
    # Where 4 x (x - 1) = -0.18.
    higher = (1.0 + np.sqrt(0.82)) / 2.0
    left = (higher**2 - 1.0) ** 2 + 0.09 * (higher + 1.0) ** 2
    for begun, place, deviance in ((-1.0, -1.0, 0.0), (1.0, higher, left)):
        looked_at.clear()
        found = at_best_fit(
            cast(Identification, setup), replace(posterior, optima=np.array([[begun, -1.0]]))
        )
        assert looked_at == pytest.approx([place, deviance], abs=1e-6)
        assert found["findings"] == (LOST,)
