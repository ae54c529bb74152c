"""Options of the verbs of identifiability, and what they share, loaded when it is first used."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from identknee.cli.digests import file_digests

if TYPE_CHECKING:
    from identknee.cli.set_up import Identification
else:
    Identification = object

WORK = "unfinished.sqlite"
__all__ = ["WORK", "Identification", "file_digests"]

Noise = Annotated[
    str | None,
    typer.Option(
        metavar="MM,DEG",
        help="Standard deviations of lengths and angles, as in 0.5mm,0.5deg, in place of the sd_ "
        "columns of the data.",
    ),
]
Start = Annotated[
    str,
    typer.Option(
        help="Where fits begin, and the values of --fix: subject (its own values), IG1 to IG4 of "
        "the paper, or a file ending in .toml."
    ),
]
Fixed = Annotated[
    list[str] | None,
    typer.Option(
        "--fix",
        metavar="NAME",
        help="A parameter held at its start, such as ACL.stiffness_kN; repeatable.",
    ),
]
Bounds = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=LOW:HIGH",
        help="Bounds in place of 0 to 40 kN and -15 to 15 %, as in ACL.stiffness_kN=5:15; "
        "repeatable.",
    ),
]


def identification(*words: Any, **options: Any) -> "Identification":
    """As `identknee.cli.set_up.identification`."""
    from identknee.cli.set_up import identification as made

    return made(*words, **options)


def measured(subject: str, data: Any, noise: str | None) -> Any:
    """Subject and data, the noise of the data as `--noise` says where it is given."""
    from identknee.laxity.table import read_laxity
    from identknee.subject.folder import read_subject
    from identknee.verbs.identification import with_noise

    return read_subject(subject), with_noise(read_laxity(data), noise)


def best_fits(setup: Any, **options: Any) -> Any:
    """As `identknee.verbs.identification.best_fits`."""
    from identknee.verbs import identification as shared

    return shared.best_fits(setup, **options)


def no_prediction(setup: Any) -> Exception:
    """As `identknee.verbs.identification.no_prediction`."""
    from identknee.verbs import identification as shared

    return shared.no_prediction(setup)
