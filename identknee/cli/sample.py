"""`identknee sample`: the posterior of the parameters, and whether it can be trusted."""

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, show, timed
from identknee.cli.identification import (
    WORK,
    Bounds,
    Fixed,
    Identification,
    Noise,
    Start,
    identification,
    no_prediction,
)
from identknee.runs.errors import InputError
from identknee.runs.files import check_readable, digest, prepare_folder
from identknee.runs.findings import Finding, finding_lines, findings_summary
from identknee.runs.record import Recording, record
from identknee.runs.resume import finish_work

Basins = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="The result.json of a sweep, in whose basins the walkers start; without it they "
        "start around fits from draws of the prior.",
    ),
]
NEnsembles = Annotated[
    int, typer.Option("--ensembles", min=2, help="Independent ensembles of walkers.")
]
Budget = Annotated[
    int,
    typer.Option(
        min=1, help="Simulations after which sampling ends anyway; more in the same --out go on."
    ),
]
Nested = Annotated[
    bool, typer.Option("--nested", help="Add a second opinion and the evidence, by dynesty.")
]
Moves = Annotated[
    str, typer.Option(help="newton uses the exact Jacobian; difference and stretch do without.")
]

# Of the options: those that the sample depends on.
DECIDING = frozenset({"n_ensembles", "moves", "noise", "start", "fixed", "bounds", "seed"})


def sample(
    context: typer.Context,
    subject: Subject,
    data: Data,
    basins: Basins = None,
    n_ensembles: NEnsembles = 4,
    moves: Moves = "newton",
    budget: Budget = 400_000,
    nested: Nested = False,
    noise: Noise = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-sample"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Sample the posterior of the parameters given the data.

    Walkers go on until the written conditions of convergence are met; result.json has their
    numbers, result.nc all draws, with laxity and ligament forces at some of them. A stopped run
    resumes.
    """
    prepare_folder(out)
    its = identification(subject, data, noise=noise, start=start, fixed=fixed, bounds=bounds)
    inputs = its.inputs | ({} if basins is None else {"basins": digest(basins)})
    optima = None if basins is None else _optima(basins, its.problem.parameters)
    recording = record("sample", context.params, inputs, seed)
    about = {
        "verb": "sample",
        "inputs": inputs,
        **{name: value for name, value in context.params.items() if name in DECIDING},
    }
    found, seconds = timed(lambda: _sampled(its, optima, about, budget, (out, workers)))
    opinion = (
        ik.identify.nested_posterior(its.problem, seed=seed) if nested and found.checks else None
    )
    assumptions = [*its.assumptions, *_about_noise(its)]
    findings = _findings(its, found)
    said = {
        "seconds": seconds,
        "assumptions": assumptions,
        "findings": findings_summary(findings),
        **_opinion(found, opinion),
    }
    summary = _written(out, its, found, said, recording)
    lines = [
        *_verdict(found),
        str(found),
        *assumptions,
        *finding_lines(findings),
        *_opinion_lines(said),
        f"{seconds:.0f} s.",
        f"Results: {out}",
    ]
    finish_work(out / WORK)
    show(summary, lines, as_json=as_json)
    if not found.checks:
        raise no_prediction(its)


def _sampled(
    its: Identification,
    optima: Any,
    about: dict[str, Any],
    budget: int,
    where: tuple[Path, int],
) -> "ik.Posterior":
    from identknee.runs.executors import process_pool
    from identknee.runs.resume import open_work

    out, workers = where
    with open_work(out / WORK, about) as store, process_pool(workers) as executor:
        return ik.sample(
            its.problem,
            optima=optima,
            ensembles=ik.identify.Ensembles(n_ensembles=about["n_ensembles"], moves=about["moves"]),
            rule=ik.identify.StopRule(budget=budget),
            seed=about["seed"],
            executor=executor,
            store=store,
        )


def _optima(path: Path, parameters: "ik.Parameters") -> Any:
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


def _findings(its: Identification, found: "ik.Posterior") -> tuple[Finding, ...]:
    if not found.checks:
        return ()
    best = int(np.argmax(found.kept_log_likelihood))
    deviance = -2.0 * float(found.kept_log_likelihood.ravel()[best])
    theta = found.kept.reshape(-1, found.kept.shape[-1])[best]
    return its.findings_at(theta, deviance)


def _verdict(found: "ik.Posterior") -> list[str]:
    """Whether the numbers below can be used, before them."""
    from identknee.identify.posterior.convergence import SampleOutcome

    if not found.checks:
        return []
    if found.last_check.is_passed:
        return ["The sample has converged and can be used."]
    unmet = sum(not met for _, _, met in found.last_check.conditions.values())
    remedy = ""
    if found.outcome is SampleOutcome.BUDGET:
        remedy = " The same command with a larger --budget goes on from here."
    n = len(found.last_check.conditions)
    return [f"A first look only: {unmet} of {n} conditions of convergence are not met.{remedy}"]


def _about_noise(its: Identification) -> list[str]:
    if its.degrees_of_freedom is None:
        return []
    return ["The posterior takes this noise for known, which makes it a little too narrow."]


def _opinion(
    found: "ik.Posterior", opinion: "ik.identify.NestedPosterior | None"
) -> dict[str, Any]:
    if opinion is None:
        return {}
    return {
        "nested": {
            "log_evidence": opinion.log_evidence,
            "log_evidence_error": opinion.log_evidence_error,
            "n_simulations": opinion.n_simulations,
            "effective_draws": opinion.effective_draws,
            "quantile_differences_in_errors": ik.identify.quantile_differences(found, opinion),
        }
    }


def _opinion_lines(said: dict[str, Any]) -> list[str]:
    if "nested" not in said:
        return []
    nested = said["nested"]
    worst = float(np.max(np.abs(nested["quantile_differences_in_errors"])))
    evidence = f"{nested['log_evidence']:.2f} +- {nested['log_evidence_error']:.2f}"
    differences = f"its quantiles differ by {worst:.1f} joint standard errors at most"
    return [f"Nested sampling: log evidence {evidence}; {differences}."]


def _written(
    out: Path,
    its: Identification,
    found: "ik.Posterior",
    said: dict[str, Any],
    recording: Recording,
) -> dict[str, Any]:
    # xarray takes longer to load than the shortest samples take.
    from identknee.report.result_files import write_result
    from identknee.report.sample_groups import predictive_groups, sample_groups, sample_summary

    groups = sample_groups(found)
    sensitivity = None
    if found.checks:
        groups |= predictive_groups(found, its.model, its.laxity, whole=its.free.expand)
        sensitivity = ik.identify.prior_sensitivity(found)
    summary = {**sample_summary(found, sensitivity), **said}
    return write_result(out, summary, groups, recording.finish())
