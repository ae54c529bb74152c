"""Replicates of simulation-based calibration, and the test of their ranks."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from knees import model
from scipy.stats import binom

from identknee.calibrate.problem import Problem
from identknee.identify.posterior.posterior import StopRule, prior_draws
from identknee.identify.posterior.sample import Ensembles, sample
from identknee.laxity.table import add_noise
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array, IntArray

N_DRAWS = 100
NOISE = 0.5  # mm and deg
# Enough for 100 independent draws and halves that agree; nothing is asked of drift.
RULE = StopRule(
    autocorrelation_times=7.0,
    drift=np.inf,
    rhat=1.05,
    effective_draws=150.0,
    effective_draws_each=40.0,
    mean_error=0.1,
    budget=2740,
)
# Two draws of each of 52 walkers, so that 4 autocorrelation times have room for 100: where the
# model has no prediction for most proposals, 7 of them take more than 3,000 simulations. Blocks are
# short so that the last one, of 260 simulations, ends below that.
ENSEMBLES = Ensembles(n_ensembles=2, n_walkers=26, steps=5, n_prior=0)
MOST_REDRAWN = 1000


@dataclass(frozen=True, kw_only=True)
class Replicate:
    """What one replicate is: its knee, the noise the likelihood is told, and its seed.

    Attributes
    ----------
    knee
        Its name.
    understated
        The likelihood takes the standard deviations for so many times smaller than they are.
    seed
        Of the truth, the data and the sample.
    """

    knee: str
    understated: float
    seed: tuple[int, ...]


def ranks_of(task: Replicate) -> dict[str, Any]:
    """Rank of the truth among 100 independent draws, by parameter, with what the sample cost.

    The truth is drawn from the prior, again where it has no prediction: the posterior gives such
    parameters no likelihood, so that prior and posterior are cut off alike.
    """
    of = model(task.knee)
    truth_seed, noise_seed, sample_seed = np.random.SeedSequence(task.seed).spawn(3)
    draws = prior_draws(of.parameters, MOST_REDRAWN, np.random.default_rng(truth_seed))
    for n_redrawn, truth in enumerate(draws):  # noqa: B007 - the first that is found
        laxity = of.simulate(truth)
        if laxity.is_measured.all():
            break
    noisy = add_noise(laxity, sd_mm=NOISE, sd_deg=NOISE, seed=noise_seed)
    assert noisy.sd is not None
    told = replace(noisy, sd=noisy.sd / task.understated)
    problem = LaxityResiduals(model=of, laxity=told, weighting="noise")
    seed = int(sample_seed.generate_state(1)[0])
    return {"n_redrawn": n_redrawn, "truth": truth, **ranked(problem, truth, seed)}


def ranked(problem: Problem, truth: Array, seed: int) -> dict[str, Any]:
    """Ranks of the truth among 100 independent draws of the problem's posterior."""
    found = sample(problem, ensembles=ENSEMBLES, rule=RULE, seed=seed)
    row: dict[str, Any] = {
        "outcome": found.outcome.value,
        "n_simulations": found.n_simulations,
        "ranks": None,
        "rhat": None,
    }
    if not found.checks:
        return row
    places = found.independent(N_DRAWS)
    row["rhat"] = float(np.max(found.last_check.rhat))
    if len(places) == N_DRAWS:
        row["ranks"] = np.sum(found.kept[tuple(places.T)] < truth, axis=0)
    return row


def simultaneous_level(ranks: IntArray, n_draws: int, *, n_simulated: int = 10_000) -> float:
    """How rare ranks as uneven as these are where all are equally likely: a p value.

    The distribution function of the ranks leaves its simultaneous band of level ``1 - p`` where
    this is below p. The band is that of all places together, found by simulating even ranks.

    Parameters
    ----------
    ranks
        0 to `n_draws`, one a replicate, shape ``(n,)``.
    n_draws
        Draws that each truth was ranked among.
    n_simulated
        Sets of even ranks simulated.

    References
    ----------
    T. Saeilynoja et al., Graphical test for discrete uniformity and its applications in
    goodness-of-fit evaluation and multiple sample comparison, Stat. Comput. 32 (2022) 32,
    doi:10.1007/s11222-022-10090-6, section 2.
    """
    n = len(ranks)
    places = np.arange(1, n_draws + 1) / (n_draws + 1)
    counts = np.arange(n + 1)[:, None]
    below, above = binom.cdf(counts, n, places), binom.sf(counts - 1, n, places)
    rareness = np.minimum(1.0, 2.0 * np.minimum(below, above))
    even = np.random.default_rng(0).multinomial(
        n, np.full(n_draws + 1, 1.0 / (n_draws + 1)), size=n_simulated
    )
    columns = np.arange(n_draws)
    simulated = rareness[np.cumsum(even, axis=1)[:, :-1], columns].min(axis=1)
    seen = np.cumsum(np.bincount(ranks, minlength=n_draws + 1))[:-1]
    return float((np.sum(simulated <= rareness[seen, columns].min()) + 1) / (n_simulated + 1))
