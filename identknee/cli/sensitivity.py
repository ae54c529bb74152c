"""`identknee sensitivity`: which parameters the laxity of a knee depends on."""

from pathlib import Path
from typing import Annotated, Literal

import typer

import identknee as ik
from identknee.cli.command import PROTOCOLS, Json, MaybeData, Out, Seed, Subject, Workers, run_verb
from identknee.cli.identification import Fixed, Start

MethodName = Literal["morris", "sobol", "delta", "pawn", "hdmr", "shapley"]
ProtocolName = Annotated[
    str | None,
    typer.Option(
        metavar="PROTOCOL",
        help=f"The trials, if there is no DATA.csv: {PROTOCOLS}. If not given: seed63.",
    ),
]
Method = Annotated[
    MethodName,
    typer.Option(
        help="morris and sobol vary the parameters independently: stiffness by +-50 % and "
        "reference strain by +-3 %. The others use the draws of --posterior, or draws "
        "from the same ranges."
    ),
]
Samples = Annotated[
    int | None,
    typer.Option(
        help="Number of trajectories for morris (256 if not given), blocks for sobol "
        "(1,024) or draws (2,048). With a larger number and the same --out the run "
        "goes on."
    ),
]
Posterior = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Results folder of: identknee sample.")
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
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Find which parameters the laxity of a knee depends on.

    Laxity is grouped by coordinate, flexion angle and kind of load. Trials without a stable
    pose are an output of their own. Parameters vary around --start. All indices, with
    confidence intervals and convergence, are in result.nc. A stopped run resumes.
    """
    run_verb(context, ik.sensitivity)
