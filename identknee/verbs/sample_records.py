"""What the answer of a sample is made of: draws, marginals, predictions, a second opinion."""

import numpy as np

from identknee.identify.posterior.posterior import Posterior, prior_sensitivity
from identknee.laxity.table import COORDINATES
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import FreeParameters
from identknee.model.quantities import tensions_of
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import OF_COORDINATE, OF_PARAMETER, array, declared, derived, entry

N_PREDICTIONS = 400
CHAIN = ("chain", "draw")


@declared
class Marginal:
    """The posterior of one parameter."""

    mean: float = entry("Posterior mean", unit=OF_PARAMETER)
    sd: float = entry("Posterior standard deviation", unit=OF_PARAMETER)
    q025: float = entry("Quantile at 2.5 %", unit=OF_PARAMETER)
    q500: float = entry("Posterior median", unit=OF_PARAMETER)
    q975: float = entry("Quantile at 97.5 %", unit=OF_PARAMETER)
    mcse_mean: float = entry("Monte Carlo standard error of the mean", unit=OF_PARAMETER)
    mcse_q025: float = entry("Monte Carlo standard error of q025", unit=OF_PARAMETER)
    mcse_q500: float = entry("Monte Carlo standard error of q500", unit=OF_PARAMETER)
    mcse_q975: float = entry("Monte Carlo standard error of q975", unit=OF_PARAMETER)
    tau: float = entry("Autocorrelation time", unit="steps")
    rhat: float = entry("R-hat between half ensembles", unit="1")
    ess_bulk: float = entry("Effective draws of the bulk", unit="1")
    ess_tail: float = entry("Effective draws of the tails", unit="1")
    prior_sensitivity: float = entry(
        "Change of the marginal when the prior is raised to a power", unit="1"
    )
    likelihood_sensitivity: float = entry("The same for the likelihood", unit="1")
    leans_on: str = entry("What it depends on: data, prior, both or neither")


@declared
class LogPrior:
    """Log prior density of draws, under the name of what it is a density of, as ArviZ has it."""

    theta: Array = array("Log prior density of theta", *CHAIN)


@declared
class Draws:
    """The steps of all walkers after burn-in; a chain is a walker, as ArviZ has it."""

    theta: Array = array(
        "Theta of each draw", *CHAIN, "parameter", unit=OF_PARAMETER, group="posterior"
    )
    log_posterior: Array = array(
        "Log likelihood and log prior density together", *CHAIN, group="sample_stats", key="lp"
    )
    log_likelihood: Array = array("Minus half the deviance", *CHAIN, group="sample_stats")
    log_prior: LogPrior = entry(
        "Log prior density of the draws", group="log_prior", is_in_json=False
    )
    acceptance: Array = array(
        "Part of its steps in which a walker moved",
        "chain",
        group="sample_stats",
        key="acceptance_rate",
    )
    ensemble: IntArray = array("Ensemble of each walker", "chain", dtype=int, group="sample_stats")
    walker: IntArray = array(
        "Number of the walker in its ensemble", "chain", dtype=int, group="sample_stats"
    )

    @property
    @derived("Walkers of all ensembles", unit="1")
    def n_chains(self) -> int:
        """Walkers of all ensembles."""
        return len(self.theta)

    @property
    @derived("Steps of each after burn-in", unit="1")
    def n_draws(self) -> int:
        """Steps of each walker after burn-in."""
        return int(self.theta.shape[1])


@declared
class PriorDraws:
    """Draws of the prior within the bounds, as one chain."""

    theta: Array = array("Theta of each draw", *CHAIN, "parameter", unit=OF_PARAMETER)


@declared
class Predictive:
    """Predictions of the model at draws as good as independent, as one chain and without noise."""

    coordinate_names: tuple[str, ...] = array(
        "Names of the coordinates", "coordinate", is_in_arrays=False
    )
    ligaments: tuple[str, ...] = array("Names of the ligaments", "ligament", is_in_arrays=False)
    coordinates: Array = array(
        "Predicted laxity; NaN without a prediction",
        *(*CHAIN, "trial", "coordinate"),
        unit=OF_COORDINATE,
    )
    tension_N: Array = array(  # noqa: N815 - the unit
        "Tension of each ligament", *CHAIN, "trial", "ligament", unit="N"
    )
    places: IntArray = array(
        "Ensemble, walker and step after burn-in of each draw",
        *("draw", "axis"),
        dtype=int,
        group="predicted_draws",
    )

    @property
    @derived("Draws predicted at", unit="1")
    def n_draws(self) -> int:
        """Draws predicted at."""
        return len(self.places)


@declared
class Nested:
    """A second opinion by nested sampling."""

    log_evidence: float = entry("Log evidence", unit="1")
    log_evidence_error: float = entry("Standard error of the log evidence", unit="1")
    n_simulations: int = entry("Simulations made", unit="1")
    effective_draws: float = entry("Equally weighted draws that are worth as much", unit="1")
    quantile_differences: Array = array(
        "Differences of the 2.5, 50 and 97.5 % quantiles from those of the sample, in their joint "
        "standard errors",
        *("parameter", "quantile"),
        is_in_json=True,
        key="quantile_differences_in_errors",
    )


def predictive(
    posterior: Posterior,
    model: LaxityModel,
    free: FreeParameters | None = None,
    *,
    n_draws: int = N_PREDICTIONS,
) -> Predictive:
    """Laxity and the tension of every ligament at draws as good as independent.

    Parameters
    ----------
    posterior
        The sample.
    model
        The model, under any protocol: also one that was not measured.
    free
        Which parameters of the model were sampled; all if None.
    n_draws
        How many draws to predict at; fewer where the sample holds fewer.
    """
    places = posterior.independent(n_draws, or_fewer=True)
    thetas = posterior.kept[tuple(places.T)]
    thetas = thetas if free is None else free.expand(thetas)
    predictions = [model.predict(theta, derivatives=False) for theta in thetas]
    return Predictive(
        coordinate_names=COORDINATES,
        ligaments=tuple(x.name for x in model.knee.ligaments),
        coordinates=np.array([[x.coordinates for x in predictions]]),
        tension_N=np.array([[tensions_of(model, x) for x in predictions]]),
        places=places,
    )


def marginals_of(posterior: Posterior) -> dict[str, Marginal]:
    """The marginal of each parameter by its name."""
    check, sensitivity = posterior.last_check, prior_sensitivity(posterior)
    quantiles, errors = posterior.quantiles(), posterior.quantile_errors()
    return {
        name: Marginal(
            mean=float(posterior.mean[i]),
            sd=float(posterior.sd[i]),
            **dict(zip(("q025", "q500", "q975"), quantiles[i].tolist(), strict=True)),
            mcse_mean=float(check.mean_error[i] * posterior.sd[i]),
            **dict(zip(("mcse_q025", "mcse_q500", "mcse_q975"), errors[i].tolist(), strict=True)),
            tau=float(check.tau[i]),
            rhat=float(check.rhat[i]),
            ess_bulk=float(check.bulk[i].sum()),
            ess_tail=float(check.tail[i].sum()),
            prior_sensitivity=float(sensitivity.prior[i]),
            likelihood_sensitivity=float(sensitivity.likelihood[i]),
            leans_on=sensitivity.verdicts[i],
        )
        for i, name in enumerate(posterior.parameters.names)
    }


def draws_of(posterior: Posterior) -> Draws:
    """The draws after burn-in, a chain for each walker."""
    n_ensembles, n_walkers, n_steps, n = posterior.kept.shape
    number = np.arange(n_ensembles * n_walkers)
    likelihood = posterior.kept_log_likelihood.reshape(-1, n_steps)
    prior = posterior.kept_log_prior.reshape(-1, n_steps)
    return Draws(
        theta=posterior.kept.reshape(-1, n_steps, n),
        log_posterior=likelihood + prior,
        log_likelihood=likelihood,
        log_prior=LogPrior(theta=prior),
        acceptance=posterior.last_check.acceptance.ravel(),
        ensemble=number // n_walkers,
        walker=number % n_walkers,
    )
