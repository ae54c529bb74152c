"""`identknee simulate`: the laxity of a knee under a protocol."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from identknee.cli.command import (
    Continuation,
    Json,
    NotComputed,
    Out,
    Seed,
    Subject,
    Workers,
    knee_digest,
    nested,
    show,
    timed,
    warm_up,
)
from identknee.cli.values import named_values, noise_sizes

if TYPE_CHECKING:
    from identknee.laxity.table import Laxity
    from identknee.model.laxity_model import LaxityModel
    from identknee.model.prediction import Prediction

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
Noise = Annotated[
    str | None, typer.Option(metavar="MM,DEG", help="Add noise of this sd, e.g. 0.3mm,0.3deg.")
]
Correlation = Annotated[
    float, typer.Option(help="Correlation that the five errors of a trial share.")
]
StudentDegrees = Annotated[
    float | None, typer.Option(help="Degrees of freedom of heavy-tailed noise; normal without.")
]


def simulate(
    context: typer.Context,
    subject: Subject,
    protocol: ProtocolName = "seed63",
    values: Values = None,
    noise: Noise = None,
    noise_correlation: Correlation = 0.0,
    noise_student: StudentDegrees = None,
    continuation: Continuation = "continuation",
    out: Out = Path("identknee-simulate"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Simulate laxity tests of SUBJECT: laxity.csv, and how each trial ended in result.json.

    A trial that did not converge has blank cells. One thread does it: more workers change nothing.
    """
    from identknee.laxity.protocol import load_protocol
    from identknee.laxity.table import Laxity, write_laxity
    from identknee.model.laxity_model import LaxityModel
    from identknee.runs.files import prepare_folder
    from identknee.runs.record import record
    from identknee.subject.folder import read_subject

    chosen = named_values(values or [], "--set")
    sizes = None if noise is None else noise_sizes(noise)
    prepare_folder(out)
    trials, knee = load_protocol(protocol), read_subject(subject)
    recording = record("simulate", context.params, {"subject": knee_digest(knee)}, seed)
    model = LaxityModel(knee=knee, protocol=trials, continuation=continuation)
    theta = model.parameters.vector(chosen)
    warm_up(model)
    prediction, seconds = timed(lambda: model.predict(theta, derivatives=False))
    comment = f"identknee simulate {subject}, protocol {trials.name}, seed {seed}"
    laxity = Laxity(protocol=trials, coordinates=prediction.coordinates, comments=(comment,))
    if sizes is not None:
        laxity = _noisy(laxity, sizes, seed, (noise_correlation, noise_student))
    write_laxity(laxity, out / LAXITY_FILE)
    # xarray takes longer to load than the simulation takes.
    from identknee.report.groups import simulation_groups
    from identknee.report.result_files import write_result

    groups = simulation_groups(model, prediction, None if sizes is None else laxity)
    summary = write_result(out, _summary(model, prediction, seconds), groups, recording.finish())
    show(summary, _lines(laxity, prediction, out), as_json=as_json)
    if not prediction.is_converged.any():
        raise NotComputed(f"none of the {trials.n} trials has an equilibrium; see {out}/result.json")


def trial_rows(names: tuple[str, ...], prediction: "Prediction") -> list[dict[str, Any]]:
    """One mapping a trial: how it ended and why, and its stability margin."""
    rows = []
    for i, (name, outcome) in enumerate(zip(names, prediction.outcomes, strict=True)):
        reason = outcome.sentence
        if not prediction.is_converged[i]:
            reason += f" {100 * prediction.reached[i]:.0f} % of the last load step was reached."
        margin = float(prediction.margins[i])
        rows.append(
            {
                "trial": name,
                "outcome": outcome.value,
                "reason": reason,
                "margin_N_per_mm": margin,
            }
        )
    return rows


def _noisy(
    laxity: "Laxity",
    sizes: tuple[float, float],
    seed: int,
    shape: tuple[float, float | None],
) -> "Laxity":
    from identknee.laxity.noise import add_noise

    return add_noise(
        laxity,
        sd_mm=sizes[0],
        sd_deg=sizes[1],
        seed=seed,
        correlation=shape[0],
        student_degrees=shape[1],
    )


def _summary(model: "LaxityModel", prediction: "Prediction", seconds: float) -> dict[str, Any]:
    names = model.parameters.names
    return {
        "subject": model.knee.name,
        "protocol": model.protocol.name,
        "n_trials": model.protocol.n,
        "n_converged": int(prediction.is_converged.sum()),
        "seconds": seconds,
        "parameters": nested(dict(zip(names, prediction.theta, strict=True))),
        "trials": trial_rows(model.protocol.trials, prediction),
    }


def _lines(laxity: "Laxity", prediction: "Prediction", out: Path) -> list[str]:
    n, converged = laxity.n, int(prediction.is_converged.sum())
    lines = [f"{converged} of {n} trials converged: {out / LAXITY_FILE}"]
    if converged:
        margin = prediction.margins[prediction.is_converged].min()
        lines.append(f"Lowest stability margin {margin:.3g} N/mm.")
    if converged < n:
        failed = Counter(x for x in prediction.outcomes if x.value != "converged")
        lines += [f"{count} x {end.value}: {end.sentence}" for end, count in failed.items()]
        lines.append("Their cells are blank; the reasons are in result.json.")
    return lines
