"""`identknee equivalents`: other parameter sets that the measurement could not tell apart."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import identknee as ik
from identknee.cli.command import (
    Data,
    Json,
    Out,
    Seed,
    Subject,
    Workers,
    nested,
    show,
    timed,
)
from identknee.cli.identification import (
    WORK,
    Bounds,
    Fixed,
    Identification,
    Noise,
    Start,
    check_start,
    file_digests,
    identification,
    no_prediction,
)
from identknee.runs.files import prepare_folder
from identknee.runs.findings import finding_lines, findings_summary
from identknee.runs.record import record
from identknee.runs.resume import finish_work
from identknee.verbs.values import named_bounds

NumberOfSets = Annotated[int, typer.Option("--n-sets", min=2, help="Parameter sets wanted.")]
Criterion = Annotated[
    Literal["noise", "paper"],
    typer.Option(
        help="noise: predictions differ by no more than --limit squared standard deviations in "
        "all. paper: by 1 mm drawer, 1.2 deg varus and internal rotation (RMSE) at each angle."
    ),
]
Limit = Annotated[
    float,
    typer.Option(
        help="The largest squared difference, in units of the criterion; 3.84 with noise allows "
        "sets that a 5 % test would tell apart more often."
    ),
]
Forces = Annotated[
    Literal["largest", "all", "none"],
    typer.Option(
        help="Ligament forces to bound: under the largest load of each kind at each angle, in all "
        "trials, or none."
    ),
]
Trials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help="Bound the forces in these trials instead of those of the data: seed63, table2, "
        "drawer or a TOML file.",
    ),
]
MOST_SHOWN = 8
# Of the options: those that the result depends on.
DECIDING = frozenset(
    {
        *("n_sets", "criterion", "limit", "forces", "trials"),
        *("noise", "start", "fixed", "bounds", "seed"),
    }
)


def equivalents(
    context: typer.Context,
    subject: Subject,
    data: Data,
    n_sets: NumberOfSets = 100,
    criterion: Criterion = "noise",
    limit: Limit = 1.0,
    forces: Forces = "largest",
    trials: Trials = None,
    noise: Noise = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-equivalents"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Find other parameter sets that the data cannot tell apart.

    They are as different as can be and predict the same laxity as the fit. With them come the
    smallest and largest value that every parameter and ligament force has among all such sets:
    what could be concluded wrongly. Every set is simulated. A stopped run resumes.
    """
    prepare_folder(out)
    # These load xarray, which takes longer than reading a subject.
    from identknee.identify.equivalents.equivalents import equivalents as find
    from identknee.report.equivalents_groups import equivalents_groups
    from identknee.report.result_files import write_result
    from identknee.runs.executors import process_pool
    from identknee.runs.resume import open_work

    its = identification(subject, data, noise=noise, start=start, fixed=fixed, bounds=bounds)
    check_start(its)
    wanted = _forces(its, forces, trials)
    inputs = its.inputs | file_digests(trials=trials)
    recording = record("equivalents", context.params, inputs, seed)
    about = {
        "verb": "equivalents",
        "inputs": inputs,
        **{name: value for name, value in context.params.items() if name in DECIDING},
    }
    fitted = ik.fit(its.problem, its.start)
    if fitted.outcome is ik.Outcome.START_FAILED:
        raise no_prediction(its)
    region = _region(its, criterion, fitted.theta, limit, bounds=bounds, fixed=fixed)
    with open_work(out / WORK, about) as store, process_pool(workers) as executor:
        found, seconds = timed(
            lambda: find(
                region,
                quantities=wanted,
                n_sets=n_sets,
                seed=seed,
                executor=executor,
                store=store,
            )
        )
    findings = its.findings_at(fitted.theta, 2.0 * fitted.objective)
    said = {
        "seconds": seconds,
        "assumptions": its.assumptions,
        "findings": findings_summary(findings),
    }
    summary = write_result(
        out,
        _summary(its, found, criterion) | said,
        equivalents_groups(found, its.model, its.free.expand(found.sets)),
        recording.finish(),
    )
    finish_work(out / WORK)
    lines = [*_lines(found, summary), *finding_lines(findings), f"Results: {out}"]
    show(summary, lines, as_json=as_json)


def _region(
    its: Identification,
    criterion: str,
    theta: Any,
    limit: float,
    *,
    bounds: list[str] | None,
    fixed: list[str] | None,
) -> Any:
    from identknee.calibrate.problem import restricted
    from identknee.identify.equivalents.region import Region, noise_region
    from identknee.model.equivalence import rms_blocks

    if criterion == "noise":
        return noise_region(its.problem, theta, limit=limit)
    plain = ik.LaxityResiduals(model=its.model, laxity=its.laxity)
    bounded = ik.calibrate.with_bounds(plain, named_bounds(bounds or [], "--bounds"))
    return Region(
        problem=restricted(bounded, fixed or (), its.free.fixed_values),
        center=theta,
        blocks=rms_blocks(plain),
        limit=limit,
    )


def _forces(its: Identification, forces: str, trials: str | None) -> list[Any]:
    from identknee.calibrate.quantity import RestrictedQuantity
    from identknee.model.equivalence import largest_loads
    from identknee.model.quantities import ligament_forces

    if forces == "none":
        return []
    if trials is None:
        # A blank trial may have no equilibrium, and then no forces.
        protocol = its.laxity.protocol.select(its.laxity.is_measured.any(axis=1))
    else:
        protocol = ik.load_protocol(trials)
    if forces == "largest":
        protocol = protocol.select(largest_loads(protocol))
    return [
        RestrictedQuantity(quantity=force, free=its.free)
        for force in ligament_forces(its.model, protocol)
    ]


def _summary(its: Identification, found: Any, criterion: str) -> dict[str, Any]:
    from identknee.identify.equivalents.region import power_of_best_test
    from identknee.report.equivalents_groups import equivalents_summary

    power = power_of_best_test(found.limit) if criterion == "noise" else None
    names = its.model.parameters.names
    return {
        "criterion": criterion,
        "power_of_best_test": power,
        **equivalents_summary(found),
        "fit": nested(dict(zip(names, its.free.expand(found.fit), strict=True))),
    }


def _lines(found: Any, summary: dict[str, Any]) -> list[str]:
    n = found.parameters.n
    ranked = sorted(found.extrema[n:], key=lambda x: float(x.lower.value - x.upper.value))
    shown = [*found.extrema[:n], *ranked[:MOST_SHOWN]]
    width = max(len(x.name) for x in shown)
    apart = (
        f"{len(found.sets)} parameter sets, each simulated: the two farthest apart by "
        f"{found.farthest:.3g} typical steps (3 kN, 2 %) of at most {found.diameter:.3g}, the two "
        f"closest by {found.closest:.2g}. {found.outcome.sentence}"
    )
    lines = [
        apart,
        f"{'':{width}}  {'fit':>9}  {'lowest':>9}  {'highest':>9}",
    ]
    lines += [
        f"{x.name:{width}}  {x.at_fit:9.4g}  {x.lower.value:9.4g}  {x.upper.value:9.4g}"
        + "".join(f"  {note}" for note in _notes(x))
        for x in shown
    ]
    if len(ranked) > MOST_SHOWN:
        lines.append(f"Of {len(ranked)} forces those that differ most; all are in result.json.")
    if summary["power_of_best_test"] is not None:
        lines.append(
            "The best 5 % test tells any one of them from the fit in "
            f"{100 * summary['power_of_best_test']:.0f} of 100 measurements at most."
        )
    return [
        *lines,
        *summary["assumptions"],
        f"{found.n_simulations} simulations.",
    ]


def _notes(of: Any) -> list[str]:
    from identknee.identify.equivalents.extremum import End

    usual = {End.LIMIT, End.INTERIOR}
    return sorted({x.end.sentence for x in (of.lower, of.upper) if x.end not in usual})
