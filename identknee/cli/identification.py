"""Options of the verbs that compare a model with data in units of the noise."""

from typing import Annotated

import typer

Noise = Annotated[
    str | None,
    typer.Option(
        metavar="MM,DEG",
        help="Standard deviations of lengths and angles, such as 0.5mm,0.5deg. They replace "
        "the sd_ columns of the data.",
    ),
]
Uncertain = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=SIZE,...",
        help="How well the knee and the tests are known, as in insertions=2mm,registration=2deg, "
        "in place of what the subject states; none if known exactly.",
    ),
]
Start = Annotated[
    str,
    typer.Option(
        help="Where fits start, and the values of parameters held by --fix: subject (its "
        "own values), IG1 to IG4 of the paper, or a file ending in .toml."
    ),
]
Fixed = Annotated[
    list[str] | None,
    typer.Option(
        "--fix",
        metavar="NAME",
        help="Hold this parameter at its start, such as ACL.stiffness_kN. May be repeated.",
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
