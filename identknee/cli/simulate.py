"""`identknee simulate`: the laxity of a knee under a protocol."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import (
    PROTOCOLS,
    Continuation,
    Json,
    Out,
    Seed,
    Subject,
    Workers,
    run_verb,
)

ProtocolName = Annotated[
    str,
    typer.Option(
        metavar="PROTOCOL",
        help=f"The trials: {PROTOCOLS}. Measured trials are run as `fit` would run them.",
    ),
]
Values = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Set a parameter, such as ACL.stiffness_kN=9.5. May be repeated.",
    ),
]
Start = Annotated[
    str,
    typer.Option(
        help="Ligament parameters: subject (its own values), IG1 to IG4 of the paper, or a "
        "file ending in .toml. --set changes single ones."
    ),
]
Noise = Annotated[
    str | None,
    typer.Option(
        metavar="MM,DEG", help="Add noise with this standard deviation, such as 0.3mm,0.3deg."
    ),
]
Correlation = Annotated[float, typer.Option(help="Correlation between the five errors of a trial.")]
StudentDegrees = Annotated[
    float | None,
    typer.Option(help="Degrees of freedom of Student's t noise; normal noise if not given."),
]
Contact = Annotated[
    Literal["field", "mesh"],
    typer.Option(
        help="field: a smooth distance field. mesh: the law of the paper between triangles, "
        "which is slow."
    ),
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
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Simulate laxity tests of SUBJECT.

    Writes the laxity to laxity.csv, and how each trial ended to result.json. A trial without a
    stable pose has blank cells.
    """
    run_verb(context, ik.simulate)
