"""The posterior of the parameters given the data, and whether it can be trusted."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np

from identknee.identify.posterior.convergence import ConvergenceCheck, SampleOutcome, StopRule
from identknee.identify.posterior.density import ExcludedMass
from identknee.identify.posterior.nested import nested_posterior, quantile_differences
from identknee.identify.posterior.posterior import Posterior
from identknee.identify.posterior.sample import Ensembles
from identknee.identify.posterior.sample import sample as sampled
from identknee.laxity.table import Laxity
from identknee.model.parameters import Parameters
from identknee.model.residuals import LaxityResiduals
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike, check_readable
from identknee.runs.findings import Finding
from identknee.verbs.answer import Answer
from identknee.verbs.identification import Identification, identification, no_prediction_finding
from identknee.verbs.options import (
    Bounds,
    Data,
    Fixed,
    KneeOptions,
    Noise,
    Seed,
    Start,
    Subject,
    option,
)
from identknee.verbs.sample_cells import MeasuredCells, measured_cells
from identknee.verbs.sample_records import (
    Draws,
    Marginal,
    Nested,
    Predictive,
    PriorDraws,
    draws_of,
    marginals_of,
    predictive,
)
from identknee.verbs.verb import Run, not_deciding, verb

OPTIMUM = ("optimum", "parameter")


@declared
class Sample(Answer):
    """The posterior of the parameters given the data, and whether it can be trusted."""

    outcome: SampleOutcome = entry("How sampling ended")
    parameters: Mapping[str, Marginal] = entry("Posterior of each parameter by its name")
    space: Parameters = entry(
        "The parameters, their bounds and priors", group="parameters", is_in_json=False
    )
    draws: Draws | None = entry("The draws; null where sampling never began", group="posterior")
    checks: tuple[ConvergenceCheck, ...] = entry(
        "All convergence checks; the last one decided", rows="check", group="gate", is_in_json=False
    )
    prior: PriorDraws = entry("Draws of the prior", group="prior", is_in_json=False)
    predictive: Predictive | None = entry(
        "Laxity and ligament forces at some of the draws",
        group="posterior_predictive",
        default=None,
    )
    cells: MeasuredCells | None = entry(
        "Likelihood and predictions of every measured value; null without a sample", default=None
    )
    data: Laxity | None = entry("The measured laxity", group="observed_data", default=None)
    excluded: ExcludedMass = entry(
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
        """What the outcome means, as a full sentence."""
        return self.outcome.sentence

    @property
    @derived("Largest R-hat of a parameter; null without a sample", unit="1")
    def rhat_max(self) -> float | None:
        """Largest R-hat of a parameter."""
        return self.last_check.conditions["rhat"][0] if self.last_check else None

    @property
    @derived("Fewest effective draws of bulk or tail; null without a sample", unit="1")
    def ess_min(self) -> float | None:
        """Fewest effective draws of the bulk or the tails of a parameter."""
        return self.last_check.conditions["effective_draws"][0] if self.last_check else None

    @property
    @derived("Every condition of convergence: its number, its bar, and whether it is met")
    def gate(self) -> dict[str, dict[str, Any]]:
        """The conditions of the last check by name."""
        conditions = self.last_check.conditions if self.last_check else {}
        return {
            name: {"value": value, "bar": bar, "met": met}
            for name, (value, bar, met) in conditions.items()
        }

    @property
    @derived("Steps of every walker, burn-in included", unit="1")
    def steps(self) -> int:
        """Steps of every walker."""
        return self.last_check.steps if self.last_check else 0

    @property
    @derived("Steps left out as burn-in", unit="1")
    def burn_in(self) -> int:
        """Steps left out at the beginning."""
        return self.last_check.burn_in if self.last_check else 0

    @property
    @derived("Part of the steps in which a walker moved: the mean and the lowest", unit="1")
    def acceptance(self) -> dict[str, float]:
        """Mean and lowest acceptance."""
        if self.last_check is None:
            return {}
        rates = self.last_check.acceptance
        return {"mean": float(rates.mean()), "lowest": float(rates.min())}

    @property
    @derived("Ensemble and number of each walker that hardly ever moved")
    def stuck_walkers(self) -> list[list[int]]:
        """Places of stuck walkers."""
        places = np.argwhere(self.last_check.stuck) if self.last_check else np.empty((0, 2))
        return [[int(x) for x in row] for row in places]

    @property
    @derived("What the walkers started around", unit=OF_PARAMETER, key="optima")
    def listed_optima(self) -> list[list[float]]:
        """The optima as lists."""
        return [[float(x) for x in row] for row in self.optima]


@verb
@not_deciding("budget", "nested")
def sample(
    run: Run,
    subject: Subject,
    data: Data,
    *,
    basins: Annotated[
        PathLike | None,
        option(
            "The result.json of a sweep. Walkers then start in its basins; otherwise around fits "
            "that start from draws of the prior.",
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
    budget: Annotated[
        int,
        option(
            "Largest number of simulations. With a larger one and the same --out the run goes on.",
            least=1,
        ),
    ] = 400_000,
    nested: Annotated[
        bool,
        option("Also run nested sampling (dynesty), as a second opinion and for the evidence."),
    ] = False,
    noise: Noise = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    seed: Seed = 0,
    **_: Unpack[KneeOptions],
) -> Sample:
    """The posterior of the parameters given the data, and whether it can be trusted.

    Walkers run until they pass the convergence checks, whose numbers are in result.json. All draws
    are in result.nc, with the laxity and the ligament forces at some of them.

    Raises
    ------
    ValueError
        If an argument or a file is wrong; the message says what to do. That the model has no
        prediction where walkers would start is no error: the answer says it in `failure`.
    ModuleNotFoundError
        If dynesty is wanted and not installed.
    """
    setup = identification(subject, data, noise=noise, start=start, fixed=fixed, bounds=bounds)
    optima = None if basins is None else _optima(Path(basins), setup.problem.parameters)
    run.start_clock()
    posterior = sampled(
        setup.problem,
        optima=optima,
        ensembles=Ensembles(n_ensembles=n_ensembles, moves=moves),
        rule=StopRule(budget=budget),
        seed=seed,
        executor=run.executor,
        store=run.store,
    )
    is_begun = bool(posterior.checks)
    predicted = predictive(posterior, setup.model, setup.free) if is_begun else None
    return as_answer(
        posterior,
        predictive=predicted,
        cells=None if predicted is None else _cells(setup, predicted, seed),
        data=setup.laxity,
        nested=_nested(setup, posterior, seed) if nested and is_begun else None,
        assumptions=(*setup.assumptions, *_about_noise(setup)),
        trials_used=setup.trials_used,
        uncertainty=setup.knee.uncertainty.words,
        findings=_findings(setup, posterior),
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


def _cells(setup: Identification, predicted: Predictive, seed: int) -> MeasuredCells:
    residuals = LaxityResiduals(model=setup.model, laxity=setup.laxity, weighting="noise")
    return measured_cells(residuals, predicted, seed)


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


def _about_noise(setup: Identification) -> tuple[str, ...]:
    if setup.degrees_of_freedom is None:
        return ()
    return ("The posterior takes this noise for known, which makes it a little too narrow.",)


def _findings(setup: Identification, posterior: Posterior) -> tuple[Finding, ...]:
    if not posterior.checks:
        return (no_prediction_finding(setup),)
    best = int(np.argmax(posterior.kept_log_likelihood))
    deviance = -2.0 * float(posterior.kept_log_likelihood.ravel()[best])
    theta = posterior.kept.reshape(-1, posterior.kept.shape[-1])[best]
    return setup.findings_at(theta, deviance, is_draw=True)
