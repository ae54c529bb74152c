"""`identknee design`: which laxity trials to add to those measured."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, show, timed
from identknee.cli.identification import (
    Bounds,
    Fixed,
    Identification,
    Noise,
    Start,
    best_fits,
    identification,
)
from identknee.runs.files import prepare_folder
from identknee.runs.findings import Finding, finding_lines, findings_summary
from identknee.runs.record import record

ADVICE = "advised_trials.csv"

NTrials = Annotated[int, typer.Option(min=1, help="How many trials to add.")]
Targets = Annotated[
    list[str] | None,
    typer.Option(
        "--target",
        metavar="NAME",
        help="Whose interval is to shrink: a parameter, ACL.tension_N@TRIAL or varus_deg@TRIAL; "
        "repeatable. Without: the parameters with open intervals, or all where none is open.",
    ),
]
CriterionName = Annotated[
    Literal["width", "c", "D", "A", "E"],
    typer.Option(
        help="What is to shrink. width: the predicted intervals of the targets; c: their "
        "variances at the best fit; D, A, E: volume, mean and largest axis of the confidence "
        "ellipsoid of all parameters."
    ),
]
CandidateTrials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help="Trials to choose from: seed63, table2, drawer or a TOML file. Without: drawer, "
        "varus-valgus and rotation tests, compression and pairs of loads at 0 to 120 deg, and "
        "repeats.",
    ),
]
Level = Annotated[float, typer.Option(help="Confidence level of the intervals, as in 0.95.")]


def design(
    context: typer.Context,
    subject: Subject,
    data: Data,
    n_trials: NTrials = 4,
    targets: Targets = None,
    criterion: CriterionName = "width",
    candidates: CandidateTrials = None,
    level: Level = 0.95,
    noise: Noise = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-design"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Choose laxity trials that would tell what is left open.

    The advice is verified: the trials are simulated at the best fit, added to the data, and the
    intervals computed again. advised_trials.csv lists them, to be filled in and appended.
    """
    prepare_folder(out)
    its = identification(subject, data, noise=noise, start=start, fixed=fixed, bounds=bounds)
    recording = record("design", context.params, its.inputs, seed)
    offered = _candidates(its, candidates)
    quantities = [_target(its, name) for name in targets or []]
    (found, findings), seconds = timed(
        lambda: _designed(
            its,
            offered,
            {"n_trials": n_trials, "targets": quantities, "criterion": criterion},
            level=level,
            seed=seed,
            workers=workers,
        )
    )
    from identknee.report.design_groups import design_groups, design_summary
    from identknee.report.result_files import write_result

    advised = _advised(its, found, offered)
    ik.write_laxity(advised, out / ADVICE)
    summary = {
        **design_summary(found, offered.protocol),
        "advised": list(advised.protocol.trials),
        "seconds": seconds,
        "degrees_of_freedom": its.degrees_of_freedom,
        "assumptions": its.assumptions,
        "findings": findings_summary(findings),
    }
    groups = design_groups(found, offered.protocol, its.problem.parameters.names)
    summary = write_result(out, summary, groups, recording.finish())
    show(summary, _lines(its, found, findings, out), as_json=as_json)


def _designed(
    its: Identification,
    offered: "ik.model.CandidateLaxity",
    wanted: dict[str, Any],
    *,
    level: float,
    seed: int,
    workers: int,
) -> "tuple[ik.Design, tuple[Finding, ...]]":
    from identknee.runs.executors import process_pool

    threshold = ik.identify.chi2_threshold(level)
    if its.degrees_of_freedom is not None:
        threshold = ik.identify.f_threshold(level, its.degrees_of_freedom)
    with process_pool(workers) as executor:
        fits = best_fits(its, seed=seed, executor=executor)
        found = ik.design(
            its.problem,
            fits[0].theta,
            offered,
            executor=executor,
            level=level,
            thresholds=threshold,
            **wanted,
        )
    best = found.before[0]
    return found, its.findings_at(best.optimum, best.deviance, fits)


def _candidates(its: Identification, name: str | None) -> "ik.model.CandidateLaxity":
    from identknee.laxity.candidates import candidate_trials
    from identknee.model.candidate_laxity import typical_errors

    protocol = candidate_trials(its.laxity.protocol) if name is None else ik.load_protocol(name)
    return ik.model.CandidateLaxity(
        model=its.model,
        laxity=its.laxity,
        protocol=protocol,
        sd=typical_errors(_with_errors(its)),
        free=its.free,
    )


def _with_errors(its: Identification) -> "ik.Laxity":
    """The data with the errors that the problem takes them to have."""
    from dataclasses import replace

    from identknee.calibrate.problem import Scaled

    if not isinstance(its.problem, Scaled):
        return its.laxity
    sd = np.full(its.laxity.coordinates.shape, np.nan)
    sd[its.laxity.is_measured] = its.problem.sd
    return replace(its.laxity, sd=sd)


def _target(its: Identification, name: str) -> "ik.calibrate.Quantity":
    from identknee.calibrate.quantity import RestrictedQuantity
    from identknee.model.quantities import AT, quantity_named

    if AT not in name:
        its.free_index(name, "--target")
        return ik.calibrate.ParameterQuantity(parameters=its.problem.parameters, name=name)
    quantity = quantity_named(its.model, name)
    return RestrictedQuantity(quantity=quantity, free=its.free)


def _advised(
    its: Identification, found: "ik.Design", offered: "ik.model.CandidateLaxity"
) -> "ik.Laxity":
    """The trials to add as a table whose coordinates are blank."""
    from identknee.laxity.candidates import repeated

    chosen = list(found.chosen)
    protocol = ik.Protocol(
        name="advised",
        trials=repeated(found.trials, its.laxity.protocol.trials),
        flexion_deg=offered.protocol.flexion_deg[chosen],
        loads=offered.protocol.loads[chosen],
    )
    return ik.Laxity(
        protocol=protocol,
        coordinates=np.full((len(chosen), offered.sd.size), np.nan),
        sd=None if its.laxity.sd is None else np.tile(offered.sd, (len(chosen), 1)),
        zero=its.laxity.zero,
        comments=("Trials advised by identknee design: measure, fill in, append to the data.",),
    )


def _lines(
    its: Identification, found: "ik.Design", findings: Sequence[Finding], out: Path
) -> list[str]:
    lines = ["Trials to add, the most telling first:"]
    lines += [f"{i}. {name}" for i, name in enumerate(found.trials, 1)]
    width = max(len(name) for name in found.targets)
    lines.append(f"{'':{width}}  {'before':>20}  {'predicted':>20}  {'achieved':>20}")
    rows = zip(found.before, found.predicted[-1], found.after, strict=True)
    for before, predicted, after in rows:
        ends = (
            (before.lower, before.upper),
            tuple(None if np.isnan(x) else float(x) for x in predicted),
            (after.lower, after.upper),
        )
        lines.append(f"{before.name:{width}}  " + "  ".join(f"{_interval(x):>20}" for x in ends))
    if found.excluded:
        example = found.excluded[0].sentence
        n = len(found.excluded)
        lines.append(f"{n} of {len(found.names)} candidates were not offered: {example}")
    return [
        *lines,
        *its.assumptions,
        *finding_lines(findings),
        f"{found.n_simulations} simulations. Results: {out}, trials to measure: {out / ADVICE}",
    ]


def _interval(ends: tuple[float | None, ...]) -> str:
    low, high = ("open" if x is None else f"{x:.3f}" for x in ends)
    return f"{low} to {high}"
