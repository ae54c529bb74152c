"""`identknee blind`: laxity of a knee with a hidden effect."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import Json, Out, Seed, SubjectOrReference, Workers, run_verb

Effect = Annotated[
    list[str],
    typer.Option(
        metavar="ID", help="The hidden cause: its name, random, or none. Two names may be given."
    ),
]
Signal = Annotated[
    float | None,
    typer.Option(
        help="Size of the effect relative to the noise; taken from the literature if not given."
    ),
]

Uncertain = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=SIZE,...",
        help="How wrong the knee and the tests are to be, as in insertions=2mm,registration=2deg: "
        "one standard deviation. Exact if not given. Give `diagnose` the same.",
    ),
]


def blind(
    context: typer.Context,
    subject: SubjectOrReference = "reference",
    effect: Effect = ("random",),  # type: ignore[assignment]
    signal: Signal = None,
    uncertain: Uncertain = None,
    out: Out = Path("identknee-blind"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Make laxity data with a hidden effect, to test a diagnosis.

    The data come from an independent generator. Writes laxity.csv for `diagnose`, and a sealed
    truth.json for `reveal`. The signal is the root of the chi-square that ligament parameters
    alone cannot fit. It runs on one thread: more workers change nothing.
    """
    answer = run_verb(context, ik.blind_test.make_blind, without=("workers",))
    if answer.remark:
        typer.echo(answer.remark, err=True)
