"""`identknee doctor`: whether this installation is sound, and what to do where it is not."""

from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import print_result

Json = Annotated[bool, typer.Option("--json", help="Print the checks as JSON, and nothing else.")]


def doctor(as_json: Json = False) -> None:
    """Check this installation, with a short self-test.

    It looks at versions, cores, cache and extras. The self-test repeats known trials of the
    reference knee. The first one after an installation compiles, which takes up to a minute. The
    exit code is 1 if anything is wrong.
    """
    print_result(ik.verbs.doctor(), as_json=as_json)
