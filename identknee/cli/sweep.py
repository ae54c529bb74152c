"""`identknee sweep`: where many searches end, and why there."""

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

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
from identknee.runs.executors import Executor, process_pool
from identknee.runs.files import prepare_folder
from identknee.runs.findings import Finding, finding_lines, findings_summary
from identknee.runs.record import Recording, record
from identknee.runs.resume import finish_work, open_work
from identknee.runs.store import Store

Starts = Annotated[int, typer.Option("--n-starts", min=1, help="Searches to make.")]
Method = Annotated[
    str,
    typer.Option(help="least-squares, complex, genetic, particle-swarm, cma-es or annealing."),
]
Budget = Annotated[
    int | None,
    typer.Option(help="Simulations a search may make; 2,500 without."),
]
Design = Annotated[
    Literal["sobol", "shells"],
    typer.Option(help="sobol: evenly over the bounds. shells: at --distances from --start."),
]
Distances = Annotated[
    str,
    typer.Option(metavar="D,D,...", help="Of shells: mean difference in kN and in %, as 0.5,1,2."),
]
Within = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Mean distance in kN and in % from the best end at which it counts as recovered.",
    ),
]
Ways = Annotated[
    int,
    typer.Option(min=0, help="Starts whose straight way to the best end is searched for cliffs."),
]

# Of the options: those that the searches depend on.
DECIDING = frozenset(
    {
        *("n_starts", "method", "design", "distances", "start", "budget"),
        *("noise", "fixed", "bounds", "seed"),
    }
)
ENDS = {"end": "the search itself", "polished": "the polished search"}
MOST_SHOWN = 8


def sweep(
    context: typer.Context,
    subject: Subject,
    data: Data,
    n_starts: Starts = 1000,
    method: Method = "least-squares",
    design: Design = "sobol",
    distances: Distances = "0,0.5,1,1.5,2,2.5,3,4,5,6",
    start: Start = "subject",
    budget: Budget = None,
    within: Within = 0.5,
    ways: Ways = 100,
    noise: Noise = None,
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-sweep"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Search from many starts and say what stopped each search.

    A minimum, an optimizer that gave up in a valley, or a cliff where the knee snaps: each end is
    polished by least squares with exact derivatives before it counts as a minimum. Basins with
    their volumes, the recovery of the best end by the distance of the start and the cliffs on the
    way go to result.json; all ends to result.nc. A stopped run resumes.
    """
    prepare_folder(out)
    its = identification(subject, data, noise=noise, start=start, fixed=fixed, bounds=bounds)
    starts = _starts(its, design, distances, n_starts, seed)
    recording = record("sweep", context.params, its.inputs, seed)
    about = {
        "verb": "sweep",
        "inputs": its.inputs,
        **{name: value for name, value in context.params.items() if name in DECIDING},
    }
    with open_work(out / WORK, about) as store, process_pool(workers) as executor:
        swept, seconds = timed(lambda: _swept(its, starts, about, executor, store))
        found = ik.identify.survey(its.problem, swept, within=within)
        cliffs = _cliffs(its, found, ways, executor, store)
    answer = (found, cliffs)
    findings = _findings(its, found)
    said = {
        "design": design,
        "seconds": seconds,
        "assumptions": its.assumptions,
        "findings": findings_summary(findings),
    }
    summary = _written(out, answer, said, recording)
    finish_work(out / WORK)
    lines = [*_lines(*answer), *its.assumptions, *finding_lines(findings), f"Results: {out}"]
    show(summary, lines, as_json=as_json)
    if found.target is None:
        raise no_prediction(its)


def _starts(its: Identification, design: str, distances: str, n_starts: int, seed: int) -> Any:
    parameters = its.problem.parameters
    if design == "sobol":
        return ik.identify.sobol_starts(parameters, n_starts, seed=seed)
    try:
        shells = [float(x) for x in distances.split(",")]
    except ValueError:
        raise ValueError(
            f"--distances {distances}: these are not numbers. Write for example 0.5,1,2"
        ) from None
    center = its.start
    return ik.identify.shell_starts(
        parameters, n_starts, center=center, distances=shells, seed=seed
    )


def _swept(
    its: Identification, starts: Any, about: dict[str, Any], executor: Executor, store: Store
) -> "ik.Sweep":
    return ik.sweep(
        its.problem,
        starts,
        method=about["method"],
        budget=about["budget"],
        seed=about["seed"],
        executor=executor,
        store=store,
    )


def _cliffs(
    its: Identification, found: "ik.identify.Survey", ways: int, executor: Executor, store: Store
) -> "ik.identify.CliffMap | None":
    if found.target is None or ways == 0:
        return None
    return ik.identify.map_cliffs(
        its.problem,
        found.sweep.starts[:ways],
        found.target,
        lost_at=partial(_lost, its),
        executor=executor,
        store=store,
    )


def _findings(its: Identification, found: "ik.identify.Survey") -> tuple[Finding, ...]:
    """What speaks against the best end, and whether others fit as well."""
    from identknee.calibrate.doubts import start_findings

    swept = found.sweep
    if found.target is None:
        return ()
    deviances = 2.0 * swept.polished_objectives
    best = int(np.argmin(deviances))
    return (
        *its.findings_at(swept.polished[best], float(deviances[best])),
        *start_findings(swept.polished, deviances, swept.parameters),
    )


def _lost(its: Identification, theta: Any) -> list[str]:
    from identknee.report.sweep_groups import trials_lost

    return trials_lost(its.model, its.free.expand(theta))


def _written(
    out: Path,
    answer: "tuple[ik.identify.Survey, ik.identify.CliffMap | None]",
    said: dict[str, Any],
    recording: Recording,
) -> dict[str, Any]:
    # xarray takes longer to load than a short sweep takes.
    from identknee.report.result_files import write_result
    from identknee.report.sweep_groups import sweep_groups, sweep_summary

    summary = {**sweep_summary(*answer), **said}
    return write_result(out, summary, sweep_groups(*answer), recording.finish())


def _lines(found: "ik.identify.Survey", cliffs: "ik.identify.CliffMap | None") -> list[str]:
    sweep = found.sweep
    lines = [f"{sweep}."]
    lines += [
        f"{name}: {ik.Outcome(name).sentence}"
        for name in sweep.counts(sweep.kind_codes)
        if name != ik.Outcome.MINIMUM.value
    ]
    lines += [
        f"basin {i}: objective {x.objective:.6g}, {x.share}"
        for i, x in enumerate(found.basins.basins[:MOST_SHOWN])
    ]
    more = len(found.basins.basins) - MOST_SHOWN
    lines += [f"and {more} more basins"] * (more > 0)
    if found.unseen.n:
        lines.append(
            f"Basins that no start has shown: {_pct(found.unseen.estimate)} % of the starts that "
            f"end in one (at most {_pct(found.unseen.upper)} %)."
        )
    lines += [_radius(found, name, words) for name, words in ENDS.items() if name in found.radii]
    if cliffs is not None:
        lost = ", ".join(f"{name} ({n})" for name, n in list(cliffs.counts().items())[:3])
        lines.append(
            f"{int(cliffs.has_cliff.sum())} of {len(cliffs.starts)} straight ways to the best end "
            f"have a cliff{f'; most often lost there: {lost}' if lost else ''}."
        )
    return lines


def _radius(found: "ik.identify.Survey", name: str, words: str) -> str:
    radius = found.radii[name]
    if radius.value == 0.0:
        return (
            f"At no distance are nine of ten starts known to lead {words} back to within "
            f"{found.within:g} kN and % of the best end: they are too few, or it is not so."
        )
    return (
        f"Nine of ten starts within {_kN_and_pct(radius.value)} of the best end (95 %: "
        f"{_kN_and_pct(radius.lower)} to {_kN_and_pct(radius.upper)}) lead {words} back to within "
        f"{found.within:g} of it."
    )


def _pct(share: float) -> str:
    return f"{100 * share:.2g}" if share < 0.995 else "100"


def _kN_and_pct(distance: float) -> str:  # noqa: N802 - the unit
    return "any distance tried" if math.isinf(distance) else f"{distance:.2g} kN and %"
