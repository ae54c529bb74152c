"""`identknee information`: what the data say about the parameters around the best fit."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start

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
    run_verb(context, ik.information)
