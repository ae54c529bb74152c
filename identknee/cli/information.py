"""`identknee information`: what the data say about the parameters around the best fit."""

from pathlib import Path
from typing import Annotated, Any, Literal

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

ScalingName = Annotated[
    Literal["typical", "prior"],
    typer.Option(
        help="What directions are measured in. typical: 3 kN and 2 %. prior: the prior's "
        "standard deviations."
    ),
]


def information(
    context: typer.Context,
    subject: Subject,
    data: Data,
    scaling: ScalingName = "typical",
    noise: Noise = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-information"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Say which combinations of parameters the data determine.

    And how well: eigenvalues of the Fisher information at the best fit with the noise of the solver
    below them, the rank at random points of the box, and where the least known combination leads.
    """
    prepare_folder(out)
    its = identification(subject, data, noise=noise, start=start, fixed=fixed, bounds=bounds)
    recording = record("information", context.params, its.inputs, seed)
    (answer, findings), seconds = timed(lambda: _found(its, scaling, seed=seed, workers=workers))
    from identknee.report.information_groups import information_groups, information_summary
    from identknee.report.result_files import write_result

    summary = {
        **information_summary(*answer),
        "seconds": seconds,
        "degrees_of_freedom": its.degrees_of_freedom,
        "assumptions": its.assumptions,
        "findings": findings_summary(findings),
    }
    summary = write_result(out, summary, information_groups(*answer), recording.finish())
    show(
        summary,
        [*_lines(its, answer), *finding_lines(findings), f"Results: {out}"],
        as_json=as_json,
    )


def _found(
    its: Identification, scaling: Literal["typical", "prior"], *, seed: int, workers: int
) -> tuple[Any, tuple[Finding, ...]]:
    from identknee.runs.executors import process_pool

    with process_pool(workers) as executor:
        fits = best_fits(its, seed=seed, executor=executor)
        structure = ik.identify.check_structure(its.problem, seed=seed, executor=executor)
    theta = fits[0].theta
    answer = (
        ik.information(its.problem, theta, scaling=scaling, seed=seed),
        structure,
        ik.identify.geodesics(its.problem, theta, scaling=scaling),
    )
    return answer, its.findings_at(theta, 2.0 * fits[0].objective, fits)


def _table(found: "ik.Information") -> list[str]:
    names = found.parameters.names
    width = max(len(name) for name in names)
    rows = zip(names, found.theta, found.sd, strict=True)
    return [
        f"{'':{width}}  {'best':>9}  {'sd':>9}",
        *(f"{name:{width}}  {best:9.4f}  {sd:9.4g}" for name, best, sd in rows),
        "These sd take the model for straight around the best fit; identknee profile does not.",
        f"{'eigenvalue':>10}  {'floor':>8}  combination, in scaled units",
        *(
            f"{value:10.4g}  {floor:8.1e}  {found.combination(i)}"
            for i, (value, floor) in enumerate(zip(found.eigenvalues, found.floors, strict=True))
        ),
    ]


def _lines(its: Identification, answer: Any) -> list[str]:
    found, structure, paths = answer
    names = found.parameters.names
    pair, index = found.collinear_sets(2)[0] if len(names) > 1 else (names, 1.0)
    return [
        (
            f"{found.n_above_noise} of {len(names)} directions stand above the solver's noise; "
            f"condition {found.condition:.3g}."
        ),
        *_table(found),
        (
            f"Most alike: {' and '.join(pair)}, collinearity {index:.3g} (all: "
            f"{found.collinearity():.3g})."
        ),
        (
            f"{structure.verdict.sentence} (rank {max(structure.rank, 0)} of {len(names)}; "
            f"{int(structure.has_prediction.sum())} of {len(structure.ranks)} random points have a "
            "prediction)"
        ),
        *(f"Least known direction: {path.sentence}" for path in paths),
        *its.assumptions,
    ]
