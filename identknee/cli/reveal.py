"""`identknee reveal`: the truth behind blind data, and how a diagnosis compares with it."""

from pathlib import Path
from typing import Annotated

import typer

import identknee as ik
from identknee.cli.command import Json, print_result

BlindFolder = Annotated[
    Path, typer.Argument(metavar="BLIND_DIR", help="A folder that `identknee blind` wrote.")
]
DiagnosisFolder = Annotated[
    Path, typer.Argument(metavar="DIAGNOSIS_DIR", help="A folder that `identknee diagnose` wrote.")
]


def reveal(blind_dir: BlindFolder, diagnosis_dir: DiagnosisFolder, as_json: Json = False) -> None:
    """Reveal a hidden effect, and score its diagnosis."""
    print_result(ik.blind_test.reveal(blind_dir, diagnosis_dir), as_json=as_json)
