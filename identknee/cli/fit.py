"""`identknee fit`: one parameter set from measured laxity and one start."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import (
    Continuation,
    Data,
    Json,
    Out,
    Seed,
    Subject,
    Workers,
    run_verb,
)

Start = Annotated[str, typer.Option(help="IG1, IG2, IG3, IG4, subject, or a file ending in .toml.")]
Method = Annotated[
    str,
    typer.Option(help="least-squares, complex, genetic, particle-swarm, cma-es or annealing."),
]
Budget = Annotated[int | None, typer.Option(help="Simulations allowed; 2,500 without.")]
Weighting = Annotated[
    Literal["unit", "noise"],
    typer.Option(help="unit: plain mm and deg (equation 6). noise: divided by the sd_ columns."),
]
Priors = Annotated[
    bool,
    typer.Option(
        "--priors", help="Add the priors; with unit weighting errors count as 1 mm and 1 deg."
    ),
]
Fixed = Annotated[
    list[str] | None,
    typer.Option("--fix", metavar="NAME", help="A parameter to hold at its start; repeatable."),
]
Bounds = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of a parameter; repeatable."),
]


def fit(
    context: typer.Context,
    subject: Subject,
    data: Data,
    start: Start = "subject",
    method: Method = "least-squares",
    budget: Budget = None,
    weighting: Weighting = "unit",
    priors: Priors = False,
    fixed: Fixed = None,
    bounds: Bounds = None,
    continuation: Continuation = "continuation",
    out: Out = Path("identknee-fit"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Fit the parameters of SUBJECT to DATA.csv.

    The fitted parameters, the error left and how the search ended go to result.json. One search is
    one thread: more workers change nothing.
    """
    run_verb(context, ik.fit)
