"""What a sample of the posterior says: how probable values are, and whether to rely on it."""

from collections.abc import Iterator

import numpy as np
from typing_extensions import override

from identknee.identify.posterior.posterior import SampleOutcome
from identknee.report.presenter import (
    NOT_CONVERGED,
    Band,
    Drawing,
    Presenter,
    Range,
    Source,
    Statement,
    settings_of,
    table,
)
from identknee.runs.declare import Array
from identknee.runs.words import interval, label, listed, parameter_words
from identknee.subject.knee import Knee
from identknee.verbs.sample import Marginal, PredictedMarginal, Sample

STIFFNESS = "stiffness_kN"
MOST_DRAWS = 400
MOST_FORCES = 16
QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
BAND_ENDS = (0.025, 0.975)
TAILS = (0.025, 0.5, 0.975)
# More of them in one sentence are no answer any more.
MOST_NAMED = 5
CONDITIONS = {
    "steps_per_tau": "length of the chain in autocorrelation times, at least",
    "effective_draws": "effective draws (bulk or tail), at least",
    "effective_draws_each": "effective draws of any one ensemble, at least",
    "tau_drift": "relative change of an autocorrelation time between checks, at most",
    "rhat": "R-hat between half ensembles, at most",
    "mean_error": "Monte Carlo error of a mean [standard deviations], at most",
}


def _is_reliable(answer: Sample) -> str:
    """Whether the sample may be relied on."""
    if answer.outcome is SampleOutcome.CONVERGED:
        return "The independent ensembles of walkers agree."
    unmet = sum(not x["met"] for x in answer.gate.values())
    count = f" {unmet} of {len(answer.gate)} conditions of convergence are not met." * bool(unmet)
    is_short = answer.outcome is SampleOutcome.BUDGET
    remedy = " The same command with a larger --budget continues from here." if is_short else ""
    return f"The sample has not converged. {answer.sentence}{count}{remedy}"


def _thinned(theta: Array) -> Array:
    """Some of the draws of all chains, evenly apart, shape ``(n, p)``."""
    flat = theta.reshape(-1, theta.shape[-1])
    chosen = np.linspace(0, len(flat) - 1, min(len(flat), MOST_DRAWS)).astype(int)
    return np.asarray(flat[chosen])


VEHTARI = "Vehtari et al. (2021), Bayesian Anal. 16(2), 667-718, doi:10.1214/20-BA1221"


class SamplePresenter(Presenter[Sample]):
    """How a sample of the posterior is shown."""

    # What the figures show stands in the table, or is for those who want to know why.
    is_folded = True

    @override
    def statements(self, answer: Sample) -> Iterator[Statement]:
        """What is probable, whether the sample converged, and what the prior excludes."""
        if answer.last_check is None:
            yield self.say(_is_reliable(answer))
            return
        marginals, own = answer.parameters, answer.space.names_of_interest
        names = [x for x in own if x.endswith(STIFFNESS)] or list(own)
        parts = []
        for name in names[:MOST_NAMED]:
            unit = "kN" if name.endswith("_kN") else "%" if name.endswith("_pct") else ""
            limits = (marginals[name].q025, marginals[name].q975)
            parts.append(f"{interval(limits, unit)} for {parameter_words(name)}")
        probable = (
            f"the 95 % {'interval is' if len(parts) == 1 else 'intervals are'} {listed(parts)}"
        )
        heads = ("parameter", "mean", "sd", "2.5 %", "97.5 %", "R-hat", "effective draws")
        yield self.say(
            f"Given the prior and the data, {probable}. {_is_reliable(answer)}",
            table(
                "Posterior of the parameters",
                [(x, None) for x in heads],
                (
                    (label(name), x.mean, x.sd, x.q025, x.q975, x.rhat, x.ess_bulk)
                    for name, x in answer.parameters.items()
                ),
                most=len(own),
            ),
        )
        check = answer.last_check
        yield self.say(
            f"Each walker made {check.steps} steps, of which the first {check.burn_in} were "
            "discarded; "
            f"{100 * check.acceptance.mean():.0f} % of the proposals were accepted.",
            table(
                "Conditions of convergence",
                ("condition", ("value", None), ("bar", None), "met"),
                (
                    (CONDITIONS.get(name, name), x["value"], x["bar"], "yes" if x["met"] else "no")
                    for name, x in answer.gate.items()
                ),
            ),
        )
        if answer.quantities:
            yield self.say(
                "Predictions at draws of the posterior, without noise.",
                table(
                    "Posterior of the predictions",
                    [(x, None) for x in ("prediction", "mean", "sd", "2.5 %", "97.5 %", "draws")],
                    (
                        (label(name), x.mean, x.sd, x.q025, x.q975, x.n_draws)
                        for name, x in answer.quantities.items()
                    ),
                ),
            )
        yield self.say(f"{answer.excluded} The sample took {answer.n_simulations} simulations.")
        if answer.nested is not None:
            nested = answer.nested
            worst = float(np.max(np.abs(nested.quantile_differences)))
            yield self.say(
                f"Nested sampling: log evidence {nested.log_evidence:.2f} ± "
                f"{nested.log_evidence_error:.2f}; its quantiles differ by {worst:.1f} joint "
                "standard errors at most."
            )

    @override
    def drawings(self, answer: Sample, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        from identknee.report.parameter_figures import (
            corner_figure,
            forces_figure,
            prior_posterior_figure,
        )

        if answer.draws is None:
            return
        names, own = answer.space.names_of_interest, answer.space.is_of_interest
        draws, prior = (_thinned(x.theta)[:, own] for x in (answer.draws, answer.prior))
        names_listed = listed(map(label, names))
        yield Drawing(
            name="prior-posterior",
            figure=prior_posterior_figure(names, prior, {"posterior": draws}),
            caption="Prior (grey) and posterior of each parameter.",
            description=f"Densities of {names_listed} before and after the data.",
        )
        yield Drawing(
            name="corner",
            figure=corner_figure(names, draws),
            caption="Every pair of parameters: 50 and 95 % of the posterior lie inside the lines. "
            "Elongated shapes are parameters that compensate for one another.",
            description=f"Pairwise posterior of {names_listed}.",
        )
        if answer.predictive is not None and answer.data is not None:
            predictive = answer.predictive
            tensions = predictive.tension_N.reshape(-1, *predictive.tension_N.shape[-2:])
            # A trial may have no prediction anywhere.
            known = np.flatnonzero(np.isfinite(tensions).any(axis=(0, 2)))
            spread = np.nanquantile(tensions[:, known], QUANTILES, axis=0)
            widths = (spread[-1] - spread[0]).max(axis=1)
            chosen = np.sort(np.argsort(-widths)[:MOST_FORCES])
            trials = [answer.data.protocol.trials[i] for i in known[chosen]]
            yield Drawing(
                name="forces",
                figure=forces_figure(
                    trials, predictive.ligaments, np.moveaxis(spread[:, chosen], 0, -1)
                ),
                caption="Ligament forces in the trials where they are least certain, around their "
                "medians: thick bars hold 50 %, thin bars 95 % of the posterior.",
                description=f"Ranges of the tension of {listed(predictive.ligaments)} in "
                f"{len(trials)} trials; the widest has {widths.max():.0f} N.",
            )

    @override
    def method(self, answer: Sample) -> Iterator[str]:
        settings, check = settings_of(answer), answer.last_check
        n = settings.get("n_ensembles")
        ensembles = f" in {n} independent ensembles" if n else ""
        chains = "" if answer.draws is None else f" by {answer.draws.n_chains} walkers"
        moves = f" with the moves {settings['moves']}" if settings.get("moves") else ""
        yield (
            f"The posterior was sampled{chains}{ensembles}{moves}, in {answer.n_simulations} "
            "simulations."
        )
        if check is not None:
            yield (
                f"Each walker made {check.steps} steps; the first {check.burn_in} were discarded."
            )
        met = [
            f"{CONDITIONS.get(name, name)} {x['bar']:g} (found: {x['value']:.4g})"
            for name, x in answer.gate.items()
            if name in ("rhat", "effective_draws")
        ]
        if met:
            yield f"Conditions of convergence were {listed(met)}."
        if settings.get("budget"):
            yield f"At most {settings['budget']} simulations were allowed."
        yield answer.sentence
        if answer.nested is not None:
            yield f"Nested sampling gave a log evidence of {answer.nested.log_evidence:.2f}."

    @override
    def sources(self, answer: Sample) -> tuple[str, ...]:
        return (VEHTARI,)

    @override
    def band(self, answer: Sample) -> Band | None:
        if answer.predictive is None:
            return None
        values = answer.predictive.coordinates
        return "95 % of the posterior", values.reshape(-1, *values.shape[-2:]), BAND_ENDS

    @override
    def ranges(self, answer: Sample) -> Iterator[tuple[str, Range]]:
        status = "probable" if answer.outcome is SampleOutcome.CONVERGED else NOT_CONVERGED
        marginals: dict[str, Marginal | PredictedMarginal] = {
            **answer.parameters,
            **answer.quantities,
        }
        for name, x in marginals.items():
            yield (
                name,
                Range(
                    source=Source.POSTERIOR, low=x.q025, high=x.q975, value=x.q500, status=status
                ),
            )
        if answer.predictive is not None and answer.data is not None:
            trials, ligaments = answer.data.protocol.trials, answer.predictive.ligaments
            tension = answer.predictive.tension_N
            draws = tension.reshape(-1, *tension.shape[-2:])
            known = np.isfinite(draws).any(axis=0)
            limits = np.nanquantile(np.where(known, draws, 0.0), TAILS, axis=0)
            for i, j in np.argwhere(known).tolist():
                name = f"{ligaments[j]}.tension_N@{trials[i]}"
                if name not in marginals:
                    low, value, high = limits[:, i, j].tolist()
                    yield (
                        name,
                        Range(
                            source=Source.POSTERIOR, low=low, high=high, value=value, status=status
                        ),
                    )
