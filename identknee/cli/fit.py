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
from identknee.cli.identification import Noise, Uncertain

Start = Annotated[
    str,
    typer.Option(
        help="Where the search starts: subject (its own values), IG1 to IG4 of the paper, or a "
        "file ending in .toml."
    ),
]
Method = Annotated[
    str,
    typer.Option(
        help="The optimizer: least-squares, complex, genetic, particle-swarm, cma-es or annealing."
    ),
]
Budget = Annotated[
    int | None, typer.Option(help="Largest number of simulations; 2,500 if not given.")
]
Weighting = Annotated[
    Literal["unit", "noise"],
    typer.Option(
        help="How errors are weighted. unit: in mm and deg, as in equation 6 of the paper. "
        "noise: divided by the sd_ columns."
    ),
]
Priors = Annotated[
    bool,
    typer.Option(
        "--priors",
        help="Use the priors of the parameters. With unit weighting the errors are taken as "
        "1 mm and 1 deg.",
    ),
]
Fixed = Annotated[
    list[str] | None,
    typer.Option(
        "--fix", metavar="NAME", help="Hold this parameter at its start. May be repeated."
    ),
]
Bounds = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=LOW:HIGH",
        help="Bounds of a parameter, such as ACL.stiffness_kN=5:15, in place of the subject's own "
        "or of 0 to 40 kN and -15 to 15 %. May be repeated.",
    ),
]
Likelihood = Annotated[
    Literal["normal", "student"],
    typer.Option(
        help="normal: least squares. student: errors with heavy tails and an estimated scale, so "
        "that values far off count little."
    ),
]
HoldOut = Annotated[
    list[str] | None,
    typer.Option(
        metavar="TRIAL",
        help="Keep this trial from the fit and predict it, with intervals. * stands for any "
        "letters, as in 'Internal*'. May be repeated.",
    ),
]


def fit(
    context: typer.Context,
    subject: Subject,
    data: Data,
    start: Start = "subject",
    method: Method = "least-squares",
    budget: Budget = None,
    weighting: Weighting = "unit",
    noise: Noise = None,
    likelihood: Likelihood = "normal",
    uncertain: Uncertain = None,
    priors: Priors = False,
    fixed: Fixed = None,
    bounds: Bounds = None,
    hold_out: HoldOut = None,
    continuation: Continuation = "continuation",
    out: Out = Path("identknee-fit"),
    seed: Seed = 0,
    workers: Workers = "1",
    as_json: Json = False,
) -> None:
    """Fit the parameters of SUBJECT to DATA.csv.

    Writes the fitted parameters, the error that is left and how the search ended to
    result.json. One process does the work:
    more workers change nothing.
    """
    run_verb(context, ik.fit)
