"""`identknee sensitivity`: which parameters the laxity of a knee depends on."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import Json, MaybeData, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Fixed, Start

MethodName = Literal["morris", "sobol", "delta", "pawn", "hdmr", "shapley"]
ProtocolName = Annotated[
    str | None,
    typer.Option(
        help="The trials without DATA.csv: seed63 (also without this), table2, drawer or a TOML "
        "file."
    ),
]
Method = Annotated[
    MethodName,
    typer.Option(
        help="morris and sobol vary parameters independently in the box k +-50 %, eps_r +-3 %; the "
        "others take the draws of --posterior, or draws from the box."
    ),
]
Samples = Annotated[
    int | None,
    typer.Option(
        help="Trajectories (256 without), blocks (1,024) or draws (2,048, at most so many of the "
        "posterior). More in the same --out continue what is there."
    ),
]
Posterior = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder of an identknee sample.")
]


def sensitivity(
    context: typer.Context,
    subject: Subject,
    data: MaybeData = None,
    protocol: ProtocolName = None,
    method: Method = "sobol",
    samples: Samples = None,
    posterior: Posterior = None,
    start: Start = "subject",
    fixed: Fixed = None,
    out: Out = Path("identknee-sensitivity"),
    seed: Seed = 0,
    workers: Workers = 1,
    as_json: Json = False,
) -> None:
    """Say which parameters the laxity of a knee depends on.

    Outputs are grouped by coordinate, flexion angle and kind of load; failures to converge are an
    output of their own. The middle of the box is --start. All indices with confidence intervals and
    their convergence go to result.nc. A stopped run resumes.
    """
    run_verb(context, ik.sensitivity)
