"""`identknee simulate`: the laxity of a knee under a protocol."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import identknee as ik
from identknee.cli.command import (
    Continuation,
    Json,
    Out,
    Seed,
    Subject,
    Workers,
    nested,
    show,
    timed,
)
from identknee.cli.identification import file_digests
from identknee.cli.lazily import knee_digest, warm_up
from identknee.runs.errors import NotComputed
from identknee.runs.files import prepare_folder
from identknee.runs.findings import Finding, finding_lines, findings_summary
from identknee.runs.record import record
from identknee.verbs.values import named_values, noise_sizes

LAXITY_FILE = "laxity.csv"

ProtocolName = Annotated[
    str, typer.Option(help="seed63, table2, drawer, or the path of a TOML file.")
]
Values = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="NAME=VALUE", help="A parameter, e.g. ACL.stiffness_kN=9.5; repeatable."
    ),
]
Start = Annotated[
    str,
    typer.Option(
        help="Parameters of the ligaments: subject (its own values), IG1 to IG4 of the paper, or a "
        "file ending in .toml; --set changes single ones."
    ),
]
Noise = Annotated[
    str | None, typer.Option(metavar="MM,DEG", help="Add noise of this sd, e.g. 0.3mm,0.3deg.")
]
Correlation = Annotated[
    float, typer.Option(help="Correlation that the five errors of a trial share.")
]
StudentDegrees = Annotated[
    float | None, typer.Option(help="Degrees of freedom of heavy-tailed noise; normal without.")
]
Contact = Annotated[
    Literal["field", "mesh"],
    typer.Option(help="A smooth field, or the paper's law between triangles, which is slow."),
]


def simulate(
    context: typer.Context,
    subject: Subject,
    protocol: ProtocolName = "seed63",
    start: Start = "subject",
    values: Values = None,
    noise: Noise = None,
    noise_correlation: Correlation = 0.0,
    noise_student: StudentDegrees = None,
    continuation: Continuation = "continuation",
    contact: Contact = "field",
    out: Out = Path("identknee-simulate"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Simulate laxity tests of SUBJECT.

    Writes laxity.csv, and how each trial ended to result.json. A trial that did not converge has
    blank cells. One thread does it: more workers change nothing.
    """
    chosen = named_values(values or [], "--set")
    noisy = None if noise is None else noise_sizes(noise)
    if noisy is None and (noise_correlation or noise_student is not None):
        raise ValueError(
            "--noise-correlation and --noise-student say of what kind the noise is; "
            "say how large with --noise, for example --noise 0.3mm,0.3deg"
        )
    prepare_folder(out)
    trials, knee = ik.load_protocol(protocol), ik.read_subject(subject)
    inputs = {"subject": knee_digest(knee), **file_digests(start=start)}
    recording = record("simulate", context.params, inputs, seed)
    parameters = ik.LaxityModel(knee=knee, protocol=trials).parameters
    theta = ik.load_start(start, parameters).tolist()
    chosen = dict(zip(parameters.names, theta, strict=True)) | chosen
    warm_up(knee, trials)
    simulation, seconds = timed(
        lambda: ik.simulate(knee, trials, chosen, continuation=continuation, contact=contact)
    )
    laxity = simulation.laxity
    if noisy is not None:
        laxity = ik.add_noise(
            laxity,
            sd_mm=noisy[0],
            sd_deg=noisy[1],
            seed=seed,
            correlation=noise_correlation,
            student_degrees=noise_student,
        )
    ik.write_laxity(laxity, out / LAXITY_FILE)
    # xarray takes longer to load than the simulation takes.
    from identknee.report.groups import simulation_groups
    from identknee.report.result_files import write_result

    groups = simulation_groups(simulation, None if noisy is None else laxity)
    from identknee.model.soundness import rim_findings

    findings = rim_findings(trials.trials, simulation.prediction)
    said = {**_summary(simulation, seconds), "findings": findings_summary(findings)}
    summary = write_result(out, said, groups, recording.finish())
    show(summary, _lines(simulation, findings, out), as_json=as_json)
    if not summary["n_converged"]:
        raise NotComputed(f"none of the {trials.n} trials has an equilibrium; see {out}")


def _summary(simulation: "ik.model.Simulation", seconds: float) -> dict[str, Any]:
    model, prediction = simulation.model, simulation.prediction
    rows = zip(
        model.protocol.trials,
        prediction.outcomes,
        simulation.reasons,
        prediction.margins,
        prediction.rim_share,
        strict=True,
    )
    return {
        "subject": model.knee.name,
        "protocol": model.protocol.name,
        "n_trials": model.protocol.n,
        "n_converged": int(prediction.is_converged.sum()),
        "seconds": seconds,
        "parameters": nested(dict(zip(model.parameters.names, prediction.theta, strict=True))),
        "trials": [
            {
                "trial": trial,
                "outcome": end.value,
                "reason": reason,
                "margin_N_per_mm": margin,
                "rim_share": rim_share,
            }
            for trial, end, reason, margin, rim_share in rows
        ],
    }


def _lines(simulation: "ik.model.Simulation", findings: Sequence[Finding], out: Path) -> list[str]:
    prediction = simulation.prediction
    n, converged = simulation.model.protocol.n, int(prediction.is_converged.sum())
    lines = [f"{converged} of {n} trials converged: {out / LAXITY_FILE}"]
    margins = prediction.margins[prediction.is_converged]
    # The mesh law has no second derivatives and no margins.
    if margins.size and math.isfinite(margin := margins.min()):
        lines.append(f"Lowest stability margin {margin:.3g} N/mm.")
    lines += finding_lines(findings)
    if converged < n:
        failed = Counter(x for x in prediction.outcomes if x is not ik.Outcome.CONVERGED)
        lines += [f"{count} x {end.value}: {end.sentence}" for end, count in failed.items()]
        lines.append("Their cells are blank; the reasons are in result.json.")
    return lines
