"""`identknee profile`: which values of each parameter, or of any prediction, the data allow."""

from collections.abc import Sequence
from functools import partial
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
    best_fits,
    file_digests,
    identification,
)
from identknee.runs.files import prepare_folder
from identknee.runs.findings import Finding, finding_lines, findings_summary
from identknee.runs.record import Recording, record
from identknee.runs.resume import finish_work

Chosen = Annotated[
    list[str] | None,
    typer.Option(
        "--parameter",
        metavar="NAME",
        help="This parameter only, such as ACL.stiffness_kN, instead of all; repeatable.",
    ),
]
Quantities = Annotated[
    list[str] | None,
    typer.Option(
        "--quantity",
        metavar="NAME",
        help="A prediction too: ACL.tension_N@TRIAL or varus_deg@TRIAL, with a name from the "
        "column trial of the data; repeatable.",
    ),
]
Forces = Annotated[
    list[str] | None,
    typer.Option(metavar="TRIAL", help="The forces of all ligaments in a trial; repeatable."),
]
Trials = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help="Where the trials of --quantity and --forces stand, if not in the data: seed63, "
        "table2, drawer or a TOML file.",
    ),
]
Pairs = Annotated[
    list[str] | None,
    typer.Option(
        "--pair",
        metavar="NAME,NAME",
        help="The joint set of two parameters, as an outline; repeatable.",
    ),
]
Level = Annotated[float, typer.Option(help="Confidence level of the sets, as in 0.95.")]
Budget = Annotated[
    int, typer.Option(min=1, help="Simulations a profile may make; most need 25 to 100.")
]
Bootstrap = Annotated[
    int,
    typer.Option(
        min=0,
        metavar="N",
        help="Thresholds from N simulated data sets, at least 20 for a level of 0.95, instead of "
        "the chi-squared law.",
    ),
]

# Of the options: those that the profiles depend on.
DECIDING = frozenset(
    {
        *("chosen", "quantities", "forces", "trials", "pairs", "level", "budget", "bootstrap"),
        *("noise", "start", "fixed", "bounds", "seed"),
    }
)


def profile(
    context: typer.Context,
    subject: Subject,
    data: Data,
    chosen: Chosen = None,
    quantities: Quantities = None,
    forces: Forces = None,
    trials: Trials = None,
    pairs: Pairs = None,
    level: Level = 0.95,
    budget: Budget = 1000,
    bootstrap: Bootstrap = 0,
    noise: Noise = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-profile"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Say which values of each parameter of SUBJECT the data allow.

    Each parameter gets the set of values that the data do not exclude, with an end only where the
    data give it one, and a verdict. An open end is null in result.json. A stopped run resumes.
    """
    prepare_folder(out)
    its = identification(subject, data, noise=noise, start=start, fixed=fixed, bounds=bounds)
    if bootstrap and its.degrees_of_freedom is not None:
        raise ValueError(
            "--bootstrap simulates noise of a stated size; state it with --noise, for example "
            "--noise 0.5mm,0.5deg"
        )
    inputs = its.inputs | file_digests(trials=trials)
    recording = record("profile", context.params, inputs, seed)
    about = {
        "verb": "profile",
        "inputs": inputs,
        **{name: value for name, value in context.params.items() if name in DECIDING},
    }
    # Refuses a level that is none before anything takes time.
    _plain_threshold(its, level)
    wanted = [*_parameters(its, chosen), *_predictions(its, quantities, forces, trials)]
    couples = [_couple(its, x) for x in pairs or []]
    (answer, fits), seconds = timed(
        lambda: _profiled(its, wanted, couples, about, out=out, workers=workers)
    )
    best = min(answer[0], key=lambda x: x.deviance)
    findings = its.findings_at(best.optimum, best.deviance, fits)
    said = {"seconds": seconds, "findings": findings_summary(findings)}
    summary = _written(out, its, answer, said, recording)
    finish_work(out / WORK)
    show(summary, _lines(its, answer, findings, out), as_json=as_json)


def _parameters(its: Identification, chosen: list[str] | None) -> "list[ik.Quantity]":
    parameters = its.problem.parameters
    names = chosen or parameters.names
    for name in names:
        its.free_index(name, "--parameter")
    return [ik.ParameterQuantity(parameters=parameters, name=name) for name in names]


def _predictions(
    its: Identification,
    names: list[str] | None,
    forces: list[str] | None,
    trials: str | None,
) -> "list[ik.Quantity]":
    from identknee.identify.quantity import RestrictedQuantity
    from identknee.model.quantities import quantity_named

    model = its.model
    if trials is not None:
        model = model.with_protocol(ik.load_protocol(trials))
    ligaments = [x.name for x in its.knee.ligaments]
    texts = [*(names or []), *(f"{x}.tension_N@{t}" for t in forces or [] for x in ligaments)]
    return [
        RestrictedQuantity(quantity=quantity_named(model, text), free=its.free) for text in texts
    ]


def _couple(its: Identification, text: str) -> tuple[str, str]:
    first, comma, second = (x.strip() for x in text.partition(","))
    if not comma:
        raise ValueError(
            f"--pair {text}: there is no second name. "
            "Write for example --pair ACL.stiffness_kN,ACL.reference_strain_pct"
        )
    for name in (first, second):
        its.free_index(name, "--pair")
    if first == second:
        raise ValueError(f"--pair {text}: a pair needs two different parameters")
    return first, second


def _profiled(
    its: Identification,
    wanted: "list[ik.Quantity]",
    couples: list[tuple[str, str]],
    about: dict[str, Any],
    *,
    out: Path,
    workers: int,
) -> "tuple[tuple[tuple[ik.Profile, ...], tuple[ik.PairProfile, ...]], tuple[ik.Fit, ...]]":
    from identknee.runs.executors import process_pool
    from identknee.runs.resume import open_work

    level = about["level"]
    with open_work(out / WORK, about) as store, process_pool(workers) as executor:
        fits = best_fits(its, seed=about["seed"], executor=executor)
        best = fits[0]
        profiles = ik.profile_quantities(
            its.problem,
            best.theta,
            wanted,
            executor=executor,
            store=store,
            level=level,
            budget=about["budget"],
            thresholds=_thresholds(its, wanted, best.theta, about, (executor, store)),
        )
        theta = min(profiles, key=lambda x: x.deviance).optimum
        both = None
        if its.degrees_of_freedom is not None:
            both = ik.f_threshold(level, its.degrees_of_freedom, 2)
        pairs = tuple(
            ik.profile_pair(
                its.problem,
                theta,
                couple,
                level=level,
                threshold=both,
                executor=executor,
                store=store,
            )
            for couple in couples
        )
    return (profiles, pairs), fits


def _thresholds(
    its: Identification,
    wanted: "list[ik.Quantity]",
    theta: Any,
    about: dict[str, Any],
    means: tuple[Any, Any],
) -> Any:
    level, n = about["level"], about["bootstrap"]
    if n == 0:
        return _plain_threshold(its, level)
    from identknee.identify.profile.thresholds import resimulated

    found = ik.bootstrap_statistics(
        partial(resimulated, its.problem, theta),
        theta,
        wanted,
        n=n,
        seed=about["seed"],
        executor=means[0],
        store=means[1],
    )
    thresholds = found.thresholds(level)[:, 0]
    # A quantity that no data set moves, as the force of a slack ligament, has no statistic.
    return np.where(thresholds > 0, thresholds, _plain_threshold(its, level))


def _plain_threshold(its: Identification, level: float) -> float:
    if its.degrees_of_freedom is not None:
        return float(ik.f_threshold(level, its.degrees_of_freedom))
    return float(ik.chi2_threshold(level))


def _written(
    out: Path,
    its: Identification,
    answer: "tuple[tuple[ik.Profile, ...], tuple[ik.PairProfile, ...]]",
    said: dict[str, Any],
    recording: Recording,
) -> dict[str, Any]:
    # xarray takes longer to load than a short profile takes.
    from identknee.report.profile_groups import pair_summary, profile_groups, profile_summary
    from identknee.report.result_files import write_result

    profiles, pairs = answer
    parameters = its.problem.parameters.names
    entries = {x.name: profile_summary(x) for x in profiles}
    best = min(profiles, key=lambda x: x.deviance)
    summary = {
        "parameters": {name: entries[name] for name in parameters if name in entries},
        "quantities": {name: x for name, x in entries.items() if name not in parameters},
        "pairs": [pair_summary(x) for x in pairs],
        "optimum": dict(zip(parameters, best.optimum.tolist(), strict=True)),
        "deviance": best.deviance,
        "n_simulations": _cost(profiles, pairs),
        "degrees_of_freedom": its.degrees_of_freedom,
        "assumptions": its.assumptions,
        **said,
    }
    groups = profile_groups(profiles, parameters, pairs)
    return write_result(out, summary, groups, recording.finish())


def _lines(
    its: Identification,
    answer: "tuple[tuple[ik.Profile, ...], tuple[ik.PairProfile, ...]]",
    findings: Sequence[Finding],
    out: Path,
) -> list[str]:
    from identknee.report.profile_table import profile_table, shown_parts

    profiles, pairs = answer
    level = 100 * profiles[0].level
    n_closed = sum(x.lower is not None and x.upper is not None for x in profiles)
    lines = [
        f"At {level:g} % confidence the data give {n_closed} of {len(profiles)} both ends.",
        *profile_table(profiles),
    ]
    ends = [(p, side) for p in profiles for side in (p.lower_side, p.upper_side)]
    lines += [
        f"{p.name}, {side.status.value} at {side.reached:.4g}: {side.sentence}"
        for p, side in ends
        if side.end is None
    ]
    lines += [
        f"{p.name}: the set has {len(p.intervals)} parts, {shown_parts(p)}."
        for p in profiles
        if len(p.intervals) > 1
    ]
    lines += [
        f"{' and '.join(x.names)}: {sum(r.status.value == 'closed' for r in x.rays)} of "
        f"{len(x.rays)} ways closed"
        for x in pairs
    ]
    n = _cost(profiles, pairs)
    said = [*its.assumptions, *finding_lines(findings)]
    return [*lines, *said, f"{n} simulations. Results: {out}"]


def _cost(profiles: "tuple[ik.Profile, ...]", pairs: "tuple[ik.PairProfile, ...]") -> int:
    return sum(x.n_simulations for x in profiles) + sum(x.n_simulations for x in pairs)
