"""`identknee sample`: the posterior of the parameters, and whether it can be trusted."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start, Uncertain

Basins = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="The result.json of a sweep. Walkers then start in its basins; otherwise "
        "around fits that start from draws of the prior.",
    ),
]
NEnsembles = Annotated[
    int, typer.Option("--ensembles", min=2, help="Number of independent ensembles of walkers.")
]
Budget = Annotated[
    int,
    typer.Option(
        min=1,
        help="Largest number of simulations. With a larger one and the same --out the run goes on.",
    ),
]
Nested = Annotated[
    bool,
    typer.Option(
        "--nested",
        help="Also run nested sampling (dynesty), as a second opinion and for the evidence.",
    ),
]
Moves = Annotated[
    str | None,
    typer.Option(
        help="How walkers move. newton, surrogate and hamiltonian use the exact Jacobian; "
        "difference and stretch do not need it.  [default: newton up to 12 parameters, surrogate "
        "beyond]"
    ),
]


def sample(
    context: typer.Context,
    subject: Subject,
    data: Data,
    basins: Basins = None,
    n_ensembles: NEnsembles = 4,
    moves: Moves = None,
    budget: Budget = 400_000,
    nested: Nested = False,
    noise: Noise = None,
    uncertain: Uncertain = None,
    start: Start = "subject",
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-sample"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Sample the posterior of the parameters given the data.

    Walkers run until they pass the convergence checks, whose numbers are in result.json. All
    draws are in result.nc, with the laxity and the ligament forces at some of them. A stopped
    run resumes.
    """
    run_verb(context, ik.sample)
