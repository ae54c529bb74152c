"""Options of the verbs of identifiability, and their set-up from the words of a command line."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from identknee.laxity.named_tables import laxity_file
from identknee.laxity.table import Laxity, read_laxity
from identknee.runs.files import PathLike, digest
from identknee.subject.folder import read_subject
from identknee.subject.knee import Knee
from identknee.verbs.identification import (
    Identification as SetUp,
)
from identknee.verbs.identification import (
    best_fits,
    check_start,
    no_prediction,
    with_noise,
)
from identknee.verbs.identification import identification as identified
from identknee.verbs.knee_digest import knee_digest
from identknee.verbs.verb import WORK

__all__ = ["WORK", "best_fits", "check_start", "no_prediction"]

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification(SetUp):
    """A set-up with the digests of what it was read from.

    Attributes
    ----------
    inputs
        SHA-256 of each input by name.
    """

    inputs: dict[str, str]


def identification(
    subject: str,
    data: PathLike,
    *,
    noise: str | None = None,
    start: str = "subject",
    fixed: Sequence[str] | None = None,
    bounds: Sequence[str] | None = None,
) -> Identification:
    """Subject and data, read, checked and compared in units of the noise."""
    laxity, knee = read_laxity(data), read_subject(subject)
    setup = identified(knee, laxity, noise=noise, start=start, fixed=fixed, bounds=bounds)
    inputs = {
        "subject": knee_digest(knee),
        "data": digest(laxity_file(data)),
        **file_digests(start=start),
    }
    fields = {name: getattr(setup, name) for name in SetUp.__slots__}
    return Identification(**fields, inputs=inputs)


def measured(subject: str, data: PathLike, noise: str | None) -> tuple[Knee, Laxity]:
    """Subject and data, the noise of the data as `--noise` says where it is given."""
    laxity, knee = read_laxity(data), read_subject(subject)
    return knee, with_noise(laxity, noise)


def file_digests(**options: str | None) -> dict[str, str]:
    """SHA-256, by option, of those options that name a file rather than something built in."""
    return {
        name: digest(value)
        for name, value in options.items()
        if value is not None and Path(value).suffix == ".toml" and Path(value).is_file()
    }
