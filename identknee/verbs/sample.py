"""The posterior of the parameters given the data, and whether it can be trusted."""

import json
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import Problem, evidence_terms
from identknee.checks.fit_checks import distinct_ends
from identknee.identify.posterior.posterior import (
    ConvergenceCheck,
    InfeasiblePriorMass,
    Posterior,
    SampleOutcome,
    StopRule,
    prior_sensitivity,
    with_uniform_priors,
)
from identknee.identify.posterior.sample import Ensembles, nested_posterior, quantile_differences
from identknee.identify.posterior.sample import sample as sampled
from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.parameters import FreeParameters, Parameters
from identknee.model.quantities import PredictedQuantity, quantity_named
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import (
    OF_COORDINATE,
    OF_PARAMETER,
    OF_QUANTITY,
    Array,
    IntArray,
    array,
    declared,
    derived,
    entry,
)
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, check_readable
from identknee.verbs import options
from identknee.verbs.answer import Answer, has_priors
from identknee.verbs.identification import (
    Identification,
    best_fits,
    identification,
    no_prediction_finding,
)
from identknee.verbs.options import option
from identknee.verbs.verb import Run, not_resume_relevant, verb

N_PREDICTIONS = 400
NOISE_AS_KNOWN = "The posterior treats this noise as known, which makes it slightly too narrow."
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
    likelihood_sensitivity: float = entry(
        "Change of the marginal when the likelihood is raised to a power", unit="1"
    )
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
        return len(self.theta)

    @property
    @derived("Steps of each after burn-in", unit="1")
    def n_draws(self) -> int:
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
    quantity_names: tuple[str, ...] = array(
        "Names of the predictions asked for", "quantity", is_in_arrays=False, default=()
    )
    quantities: Array | None = array(
        "Predictions asked for; missing where none was, NaN without one",
        *(*CHAIN, "quantity"),
        unit=OF_QUANTITY,
        default=None,
    )

    @property
    @derived("Draws predicted at", unit="1")
    def n_draws(self) -> int:
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
    quantities: Sequence[PredictedQuantity] = (),
    n_draws: int = N_PREDICTIONS,
) -> Predictive:
    """Laxity, the tension of every ligament and other quantities at draws as good as independent.

    Parameters
    ----------
    posterior
        The sample.
    model
        The model, under any protocol: also one that was not measured.
    free
        Which parameters of the model were sampled; all if None.
    quantities
        What else to predict; of this model.
    n_draws
        How many draws to predict at; fewer where the sample holds fewer.
    """
    places = posterior.independent(n_draws)
    thetas = posterior.kept[tuple(places.T)]
    thetas = thetas if free is None else free.expand(thetas)
    predictions = [model.predict(theta, derivatives=False) for theta in thetas]
    return Predictive(
        coordinate_names=COORDINATES,
        ligaments=tuple(x.name for x in model.knee.ligaments),
        coordinates=np.array([[x.coordinates for x in predictions]]),
        tension_N=np.array([[tensions_of(model, x) for x in predictions]]),
        places=places,
        quantity_names=tuple(x.name for x in quantities),
        quantities=np.array([[[x.value(y) for x in quantities] for y in predictions]])
        if quantities
        else None,
    )


@declared
class PredictedMarginal:
    """The posterior of one prediction, over the draws that have one."""

    mean: float = entry("Posterior mean", unit=OF_QUANTITY)
    sd: float = entry("Posterior standard deviation", unit=OF_QUANTITY)
    q025: float = entry("Quantile at 2.5 %", unit=OF_QUANTITY)
    q500: float = entry("Posterior median", unit=OF_QUANTITY)
    q975: float = entry("Quantile at 97.5 %", unit=OF_QUANTITY)
    n_draws: int = entry("Draws that have a prediction", unit="1")


def predicted_marginals(found: Predictive) -> dict[str, PredictedMarginal]:
    """The marginal of each prediction asked for by its name, where any draw has one."""
    made: dict[str, PredictedMarginal] = {}
    if found.quantities is None:
        return made
    for name, column in zip(found.quantity_names, found.quantities[0].T, strict=True):
        values = column[np.isfinite(column)]
        if values.size:
            low, middle, high = np.quantile(values, (0.025, 0.5, 0.975)).tolist()
            made[name] = PredictedMarginal(
                mean=float(values.mean()),
                sd=float(values.std()),
                q025=low,
                q500=middle,
                q975=high,
                n_draws=values.size,
            )
    return made


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


@declared
class CellValues:
    """The measured values in a row."""

    laxity: Array = array("Measured laxity", "cell", unit=OF_COORDINATE)


@declared
class CellDensity:
    """Log density of the measured values, under the name of what it is a density of."""

    laxity: Array = array(
        "Log density of each measured value, given those before it in its trial", *CHAIN, "cell"
    )


@declared
class CellDraws:
    """Laxity as it would be measured again, at draws of the posterior."""

    laxity: Array = array(
        "Laxity as it would be measured again, with noise", *CHAIN, "cell", unit=OF_COORDINATE
    )


@declared
class MeasuredCells:
    """Every measured value with its likelihood and predictions, at the predicted draws."""

    names: tuple[str, ...] = array(
        "Trial and coordinate of each measured value", "cell", is_in_arrays=False
    )
    measured: CellValues = entry("Measured values", group="observed_data", is_in_json=False)
    log_likelihood: CellDensity = entry(
        "Likelihood of the measured values", group="log_likelihood", is_in_json=False
    )
    replicated: CellDraws = entry(
        "Predictions of the measured values", group="posterior_predictive", is_in_json=False
    )

    @property
    @derived("Measured values", unit="1")
    def n_cells(self) -> int:
        return len(self.names)


def measured_cells(residuals: LaxityResiduals, predictive: Predictive, seed: int) -> MeasuredCells:
    """The measured values with their likelihood and predictions at the draws of `predictive`.

    Parameters
    ----------
    residuals
        Residuals of the model against the data, weighted by their noise.
    predictive
        Predictions of the same model under the trials of the data.
    seed
        Seed of the noise on the predictions.
    """
    laxity = residuals.laxity
    coordinates = predictive.coordinates[0]
    density = np.array([residuals.log_density(x) for x in coordinates])
    predicted = np.array([residuals.as_measured(x) for x in coordinates])
    noisy = predicted + _errors(laxity, len(predicted), seed)
    cells = zip(
        product(laxity.protocol.trials, COORDINATES), laxity.is_measured.ravel(), strict=True
    )
    return MeasuredCells(
        names=tuple(f"{trial} {name}" for (trial, name), is_measured in cells if is_measured),
        measured=CellValues(laxity=laxity.coordinates[laxity.is_measured]),
        log_likelihood=CellDensity(laxity=density[None]),
        replicated=CellDraws(laxity=noisy[:, laxity.is_measured][None]),
    )


def _errors(laxity: Laxity, n: int, seed: int) -> Array:
    """Draws of the measurement error [mm, deg], shape ``(n, trials, 5)``."""
    k = len(COORDINATES)
    shared = np.full((k, k), laxity.within_trial_correlation)
    np.fill_diagonal(shared, 1.0)
    draws = np.random.default_rng(seed).standard_normal((n, laxity.n, k))
    return np.asarray(laxity.sd * np.einsum("ij,mnj->mni", np.linalg.cholesky(shared), draws))


OPTIMUM = ("optimum", "parameter")


@declared
class Sample(Answer):
    """The posterior of the parameters given the data, and whether it can be trusted."""

    outcome: SampleOutcome = entry("How sampling ended")
    parameters: Mapping[str, Marginal] = entry("Posterior of each parameter by its name")
    quantities: Mapping[str, PredictedMarginal] = entry(
        "Posterior of each prediction asked for by its name",
        default_factory=dict,
    )
    space: Parameters = entry(
        "The parameters, their bounds and priors", group="parameters", is_in_json=False
    )
    draws: Draws | None = entry("The draws; null where sampling never began", group="posterior")
    checks: tuple[ConvergenceCheck, ...] = entry(
        "All convergence checks; the last one decided", rows="check", group="gate", is_in_json=False
    )
    prior: PriorDraws = entry("Draws of the prior", group="prior", is_in_json=False)
    predictive: Predictive | None = entry(
        "Laxity, ligament forces and other predictions at some of the draws",
        group="posterior_predictive",
        default=None,
    )
    cells: MeasuredCells | None = entry(
        "Likelihood and predictions of every measured value; null without a sample", default=None
    )
    data: Laxity | None = entry("The measured laxity", group="observed_data", default=None)
    excluded: InfeasiblePriorMass = entry(
        "How much of the prior the posterior cannot reach", key="excluded_prior"
    )
    optima: Array = array("What the walkers started around", *OPTIMUM, unit=OF_PARAMETER)
    n_simulations: int = entry("Simulations made in all", unit="1")
    seed: int = entry("Seed of all random numbers")
    nested: Nested | None = entry(
        "A second opinion by nested sampling", only="`--nested`", default=None
    )

    @property
    def last_check(self) -> ConvergenceCheck | None:
        """The convergence check that decided; None where sampling never began."""
        return self.checks[-1] if self.checks else None

    @property
    @derived("What the outcome means")
    def sentence(self) -> str:
        return self.outcome.sentence

    @property
    @derived("Largest R-hat of a parameter; null without a sample", unit="1")
    def rhat_max(self) -> float | None:
        return self.last_check.conditions["rhat"][0] if self.last_check else None

    @property
    @derived("Fewest effective draws of bulk or tail; null without a sample", unit="1")
    def ess_min(self) -> float | None:
        return self.last_check.conditions["effective_draws"][0] if self.last_check else None

    @property
    @derived("Every condition of convergence: its number, its bar, and whether it is met")
    def gate(self) -> dict[str, dict[str, Any]]:
        conditions = self.last_check.conditions if self.last_check else {}
        return {
            name: {"value": value, "bar": bar, "met": met}
            for name, (value, bar, met) in conditions.items()
        }

    @property
    @derived("Steps of every walker, burn-in included", unit="1")
    def steps(self) -> int:
        return self.last_check.steps if self.last_check else 0

    @property
    @derived("Steps left out as burn-in", unit="1")
    def burn_in(self) -> int:
        return self.last_check.burn_in if self.last_check else 0

    @property
    @derived("Part of the steps in which a walker moved: the mean and the lowest", unit="1")
    def acceptance(self) -> dict[str, float]:
        if self.last_check is None:
            return {}
        rates = self.last_check.acceptance
        return {"mean": float(rates.mean()), "lowest": float(rates.min())}

    @property
    @derived("Ensemble and number of each walker that hardly ever moved")
    def stuck_walkers(self) -> list[list[int]]:
        places = np.argwhere(self.last_check.stuck) if self.last_check else np.empty((0, 2))
        return [[int(x) for x in row] for row in places]

    @property
    @derived("What the walkers started around", unit=OF_PARAMETER, key="optima")
    def listed_optima(self) -> list[list[float]]:
        return [[float(x) for x in row] for row in self.optima]


@verb
@not_resume_relevant("budget", "nested", "quantities")
def sample(
    run: Run,
    subject: options.Subject,
    data: options.Data,
    *,
    basins: Annotated[
        PathLike | None,
        option(
            "The result.json of a sweep. Walkers then start in its basins; otherwise around fits.",
            metavar="FILE",
            typed=Path | None,
        ),
    ] = None,
    n_ensembles: Annotated[
        int, option("Number of independent ensembles of walkers.", "--ensembles", least=2)
    ] = 4,
    moves: Annotated[
        str | None,
        option(
            "How walkers move. newton, surrogate and hamiltonian use the exact Jacobian; "
            "difference and stretch do not need it.  [default: newton up to 12 parameters, "
            "surrogate beyond]"
        ),
    ] = None,
    quantities: Annotated[
        Sequence[str] | None,
        option(
            f"Also give the posterior of a prediction. {options.PREDICTIONS}",
            "--quantity",
            in_python="A list of names.",
            metavar="NAME",
        ),
    ] = None,
    budget: Annotated[
        int,
        option(
            "Largest number of simulations. With a larger one and the same {--out} the run goes "
            "on.",
            least=1,
        ),
    ] = 400_000,
    nested: Annotated[
        bool,
        option("Also run nested sampling (dynesty), as a second opinion and for the evidence."),
    ] = False,
    noise: options.Noise = None,
    start: options.Start = "subject",
    fixed: options.Fixed = None,
    bounds: options.Bounds = None,
    priors: options.Priors = None,
    discrepancy: options.Discrepancy = "none",
    seed: options.Seed = 0,
    **_: Unpack[options.FitOptions],
) -> Sample:
    """The posterior of the parameters given the data, and whether it can be trusted.

    Walkers run until they pass the convergence checks, whose numbers are in result.json. All draws
    are in result.nc, with the laxity, the ligament forces and other predictions at some of them.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do. That the model has no
        prediction where walkers would start is no error: the answer says it in `failure`.
    ModuleNotFoundError
        If dynesty is wanted and not installed.
    """
    setup = identification(
        subject,
        data,
        noise=noise,
        start=start,
        fixed=fixed,
        bounds=bounds,
        priors=has_priors("sample", priors),
        discrepancy=discrepancy,
    )
    problem: Problem = setup.problem
    if not has_priors("sample", priors):
        problem = with_uniform_priors(problem)
    optima = None if basins is None else _optima(Path(basins), problem.parameters)
    wanted = [quantity_named(setup.model, x) for x in quantities or ()]
    run.start_clock()
    if optima is None and setup.model.poses is not None:
        # Hardly a draw of the priors has an equilibrium in every trial where the knee begins at
        # measured poses.
        ends = best_fits(setup, seed=seed, executor=run.executor)
        whole = [x for x in ends if np.isfinite(setup.problem.residuals(x.theta)).all()]
        optima = np.array([x.theta for x in distinct_ends(whole)[:n_ensembles]])
    posterior = sampled(
        problem,
        optima=optima,
        ensembles=Ensembles(n_ensembles=n_ensembles, moves=moves),
        rule=StopRule(budget=budget),
        seed=seed,
        executor=run.executor,
        store=run.store,
    )
    more: dict[str, Any] = {"findings": (no_prediction_finding(setup),)}
    if posterior.checks:
        predicted = predictive(posterior, setup.model, setup.free, quantities=wanted)
        residuals = LaxityResiduals(model=setup.model, laxity=setup.laxity, weighting="noise")
        more = {
            "predictive": predicted,
            "quantities": predicted_marginals(predicted),
            "cells": measured_cells(residuals, predicted, seed),
            "nested": _nested(setup, posterior, seed) if nested else None,
            **at_best_fit(setup, posterior),
        }
    is_estimated = setup.degrees_of_freedom is not None
    return as_answer(
        posterior,
        data=setup.laxity,
        assumptions=(*setup.assumptions, *([NOISE_AS_KNOWN] if is_estimated else [])),
        trials_used=setup.trials_used,
        uncertainty=setup.knee.uncertainty.words,
        **more,
    )


def as_answer(posterior: Posterior, **more: Any) -> Sample:
    """A sample of the posterior as the verb gives it back, with `more` of its fields."""
    return Sample(
        outcome=posterior.outcome,
        parameters=marginals_of(posterior) if posterior.checks else {},
        space=posterior.parameters,
        draws=draws_of(posterior) if posterior.checks else None,
        checks=posterior.checks,
        prior=PriorDraws(theta=posterior.prior[None]),
        excluded=posterior.excluded,
        optima=posterior.optima,
        n_simulations=posterior.n_simulations,
        seed=posterior.seed,
        **more,
    )


def _nested(setup: Identification, posterior: Posterior, seed: int) -> Nested:
    opinion = nested_posterior(setup.problem, seed=seed)
    return Nested(
        log_evidence=opinion.log_evidence,
        log_evidence_error=opinion.log_evidence_error,
        n_simulations=opinion.n_simulations,
        effective_draws=opinion.effective_draws,
        quantile_differences=quantile_differences(posterior, opinion),
    )


def _optima(path: Path, parameters: Parameters) -> Array:
    """Thetas of the basins that a sweep's summary lists, shape ``(k, n)``."""
    wrong = "Give the result.json of: identknee sweep, with the same parameters."
    try:
        listed = json.loads(check_readable(path).read_text(encoding="utf-8"))["basins"]
        thetas = [[float(x["parameters"][name]) for name in parameters.names] for x in listed]
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(path, "", f"it does not list basins ({error})", wrong) from error
    if not thetas:
        raise InputError(path, "", "it lists no basin", "Sweep from more starts, or leave it out.")
    return np.array(thetas)


def at_best_fit(setup: Identification, posterior: Posterior) -> dict[str, Any]:
    """Terms of the deviance, and findings, at the best fit that walkers began at or came by."""
    likeliest = int(np.argmax(posterior.kept_log_likelihood + posterior.kept_log_prior))
    drawn = posterior.kept.reshape(-1, posterior.kept.shape[-1])[likeliest]
    best = min(
        (fit(setup.problem, x) for x in (*posterior.optima, drawn)), key=lambda x: x.objective
    )
    return {
        "evidence": evidence_terms(setup.problem, best.theta),
        "findings": setup.findings_at(best.theta, best.deviance),
    }
