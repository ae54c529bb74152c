"""`identknee sweep`: where many searches end, and why there."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import Data, Json, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Bounds, Fixed, Noise, Start

Starts = Annotated[int, typer.Option("--n-starts", min=1, help="Searches to make.")]
Method = Annotated[
    str,
    typer.Option(help="least-squares, complex, genetic, particle-swarm, cma-es or annealing."),
]
Budget = Annotated[int | None, typer.Option(help="Simulations a search may make; 2,500 without.")]
Design = Annotated[
    Literal["sobol", "shells"],
    typer.Option(help="sobol: evenly over the bounds. shells: at --distances from --start."),
]
Distances = Annotated[
    str,
    typer.Option(metavar="D,D,...", help="Of shells: mean difference in kN and in %, as 0.5,1,2."),
]
Within = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Mean distance in kN and in % from the best end at which it counts as recovered.",
    ),
]
Paths = Annotated[
    int,
    typer.Option(min=0, help="Starts whose straight path to the best end is searched for cliffs."),
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
    fixed: Fixed = None,
    bounds: Bounds = None,
    out: Out = Path("identknee-sweep"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Search from many starts and say what stopped each search.

    A minimum, an optimizer that gave up in a valley, or a cliff where the knee snaps through: each
    end is polished by least squares with exact derivatives before it counts as a minimum. Basins
    with their volumes, the recovery of the best end by the distance of the start and the cliffs on
    the path go to result.json; all ends to result.nc. A stopped run resumes.
    """
    run_verb(context, ik.sweep)
