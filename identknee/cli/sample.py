"""`identknee sample`: the posterior of the parameters, and whether it can be trusted."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start

Basins = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="The result.json of a sweep, in whose basins the walkers start; without it they "
        "start around fits from draws of the prior.",
    ),
]
NEnsembles = Annotated[
    int, typer.Option("--ensembles", min=2, help="Independent ensembles of walkers.")
]
Budget = Annotated[
    int,
    typer.Option(
        min=1, help="Simulations after which sampling ends anyway; more in the same --out go on."
    ),
]
Nested = Annotated[
    bool, typer.Option("--nested", help="Add a second opinion and the evidence, by dynesty.")
]
Moves = Annotated[
    str, typer.Option(help="newton uses the exact Jacobian; difference and stretch do without.")
]


def sample(
    context: typer.Context,
    subject: Subject,
    data: Data,
    basins: Basins = None,
    n_ensembles: NEnsembles = 4,
    moves: Moves = "newton",
    budget: Budget = 400_000,
    nested: Nested = False,
    noise: Noise = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-sample"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Sample the posterior of the parameters given the data.

    Walkers go on until the written conditions of convergence are met; result.json has their
    numbers, result.nc all draws, with laxity and ligament forces at some of them. A stopped run
    resumes.
    """
    run_verb(context, ik.sample)
