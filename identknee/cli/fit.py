"""`identknee fit`: one parameter set from measured laxity and one start."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import identknee as ik
from identknee.cli.command import (
    Continuation,
    Data,
    Json,
    Out,
    Seed,
    Subject,
    Workers,
    nested,
    show,
)
from identknee.cli.lazily import knee_digest, warm_up
from identknee.laxity.named_tables import laxity_file
from identknee.runs.errors import NotComputed
from identknee.runs.files import digest, prepare_folder
from identknee.runs.findings import Finding, Severity, finding_lines, findings_summary
from identknee.runs.record import Recording, record
from identknee.verbs.values import named_bounds

Start = Annotated[str, typer.Option(help="IG1, IG2, IG3, IG4, subject, or a file ending in .toml.")]
Method = Annotated[
    str,
    typer.Option(help="least-squares, complex, genetic, particle-swarm, cma-es or annealing."),
]
Budget = Annotated[int | None, typer.Option(help="Simulations allowed; 2,500 without.")]
Weighting = Annotated[
    Literal["unit", "noise"],
    typer.Option(help="unit: plain mm and deg (equation 6). noise: divided by the sd_ columns."),
]
Priors = Annotated[
    bool,
    typer.Option(
        "--priors", help="Add the priors; with unit weighting errors count as 1 mm and 1 deg."
    ),
]
Fixed = Annotated[
    list[str] | None,
    typer.Option("--fix", metavar="NAME", help="A parameter to hold at its start; repeatable."),
]
Bounds = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of a parameter; repeatable."),
]


def fit(
    context: typer.Context,
    subject: Subject,
    data: Data,
    start: Start = "subject",
    method: Method = "least-squares",
    budget: Budget = None,
    weighting: Weighting = "unit",
    priors: Priors = False,
    fixed: Fixed = None,
    bounds: Bounds = None,
    continuation: Continuation = "continuation",
    out: Out = Path("identknee-fit"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Fit the parameters of SUBJECT to DATA.csv.

    The fitted parameters, the error left and how the search ended go to result.json. One search is
    one thread: more workers change nothing.
    """
    limits = named_bounds(bounds or [], "--bounds")
    prepare_folder(out)
    laxity, knee = ik.read_laxity(data), ik.read_subject(subject)
    inputs = {"subject": knee_digest(knee), "data": digest(laxity_file(data))}
    recording = record("fit", context.params, inputs, seed)
    model = ik.LaxityModel(knee=knee, protocol=laxity.protocol, continuation=continuation)
    residuals = ik.LaxityResiduals(model=model, laxity=laxity, weighting=weighting)
    problem = ik.calibrate.with_bounds(residuals, limits)
    theta = ik.load_start(start, problem.parameters)
    warm_up(knee, laxity.protocol)
    found = ik.fit(
        problem,
        theta,
        method=method,
        seed=seed,
        budget=budget,
        fixed=fixed or (),
        priors=priors,
    )
    fitted = ik.model.Simulation(
        model=model, prediction=model.predict(found.theta, derivatives=False)
    )
    error = ik.laxity_rmse(fitted.laxity, laxity)
    from identknee.diagnosis.fit_findings import fit_findings, lost_trials

    findings = fit_findings(problem, found, fitted, error, laxity)
    lost = lost_trials(fitted, laxity)
    said = _summary(found, error, start) | {
        "findings": findings_summary(findings),
        "trials_without_equilibrium": [
            {"trial": x.trial, "outcome": x.outcome.value, "reason": x.reason} for x in lost
        ],
    }
    summary = _write(out, said, (found, fitted, laxity), recording)
    show(summary, _lines(found, error, findings, out), as_json=as_json)
    if found.outcome is ik.Outcome.START_FAILED:
        raise NotComputed(
            f"{found.message} {lost[0].trial}: {lost[0].reason} Choose another --start, or see: "
            f"identknee subject check {subject}"
        )


def _write(
    out: Path,
    summary: dict[str, Any],
    results: "tuple[ik.Fit, ik.model.Simulation, ik.Laxity]",
    recording: Recording,
) -> dict[str, Any]:
    # xarray takes longer to load than most fits take.
    from identknee.report.groups import fit_groups
    from identknee.report.result_files import write_result

    return write_result(out, summary, fit_groups(*results), recording.finish())


def _summary(found: "ik.Fit", error: "ik.laxity.LaxityError", start: str) -> dict[str, Any]:
    names = found.parameters.names
    return {
        "outcome": found.outcome.value,
        "sentence": found.message,
        "objective": found.objective,
        "n_simulations": found.n_simulations,
        "seconds": found.seconds,
        "method": found.method,
        "start": start,
        "parameters": nested(dict(zip(names, found.theta, strict=True))),
        "start_parameters": nested(dict(zip(names, found.start, strict=True))),
        "rmse": {"mm": error.mm, "deg": error.deg},
        "n_compared": error.n_compared,
        "n_missing": error.n_missing,
        "at_bounds": found.at_bounds,
        "fixed": found.fixed,
        "gradient_norm": found.gradient_norm,
    }


def _lines(
    found: "ik.Fit", error: "ik.laxity.LaxityError", findings: Sequence[Finding], out: Path
) -> list[str]:
    where = f"Results: {out}"
    if found.outcome is ik.Outcome.START_FAILED:
        return [*finding_lines(findings), where]
    width = max(len(name) for name in found.parameters.names)
    lines = [f"{'':{width}}  {'start':>9}  {'fitted':>9}"]
    for name, start, end in zip(found.parameters.names, found.start, found.theta, strict=True):
        note = "  fixed" if name in found.fixed else ""
        note = note or ("  at its bound" if name in found.at_bounds else "")
        lines.append(f"{name:{width}}  {start:9.4f}  {end:9.4f}{note}")
    lines += [
        f"RMSE {error.mm:.3g} mm, {error.deg:.3g} deg over {error.n_compared} measured values.",
        f"{found.message} {found.seconds:.2f} s.",
        *finding_lines(findings),
    ]
    if all(x.severity is Severity.INFO for x in findings):
        fits = "" if findings else " that fits"
        lines.append(f"This is one parameter set{fits}; how well it is known is another question.")
    return [*lines, where]
