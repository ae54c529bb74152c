"""`identknee sweep`: where many searches end, and why there."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start, Uncertain

Starts = Annotated[int, typer.Option("--n-starts", min=1, help="Number of starts.")]
Method = Annotated[
    str,
    typer.Option(
        help="The optimizer: least-squares, complex, genetic, particle-swarm, cma-es or annealing."
    ),
]
Budget = Annotated[
    int | None, typer.Option(help="Largest number of simulations per search; 2,500 if not given.")
]
Design = Annotated[
    Literal["sobol", "shells"],
    typer.Option(
        help="How starts are placed. sobol: evenly within the bounds. shells: at "
        "--distances from --start."
    ),
]
Distances = Annotated[
    str,
    typer.Option(
        metavar="D,D,...",
        help="For shells: mean differences from --start in kN and in %, such as 0.5,1,2.",
    ),
]
Within = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="A search recovers the best fit if it ends within this mean distance of it, in "
        "kN and in %.",
    ),
]
Paths = Annotated[
    int,
    typer.Option(
        min=0, help="For how many starts to search the straight path to the best fit for cliffs."
    ),
]


def sweep(
    context: typer.Context,
    subject: Subject,
    data: Data,
    n_starts: Starts = 1000,
    method: Method = "least-squares",
    design: Design = "sobol",
    distances: Distances = "0,0.5,1,1.5,2,2.5,3,4,5,6",
    start: Start = "subject",
    budget: Budget = None,
    within: Within = 0.5,
    paths: Paths = 100,
    noise: Noise = None,
    uncertain: Uncertain = None,
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-sweep"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Fit from many starts, and see what stopped each search.

    A search may end in a minimum, give up in a valley, or stop at a cliff, where the simulated
    knee jumps. Least squares with exact derivatives goes on from each end, so that only real
    minima count. Writes to result.json the basins with their volumes, how often the best fit is
    found from how far away, and the cliffs on the way. All ends are in result.nc. A stopped run
    resumes.
    """
    run_verb(context, ik.sweep)
