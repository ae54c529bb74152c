"""A blind case on disk: the data anybody may see, and the sealed truth."""

from pathlib import Path

from identknee.blind.case import BlindCase
from identknee.blind.truth import write_truth
from identknee.laxity.table import write_laxity
from identknee.runs.files import PathLike, prepare_folder

LAXITY_FILE = "laxity.csv"


def write_blind(case: BlindCase, folder: PathLike) -> Path:
    """Path of the folder that now holds the case: ``laxity.csv`` and the sealed ``truth.json``.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    target = prepare_folder(folder)
    write_laxity(case.laxity, target / LAXITY_FILE)
    write_truth(case.truth, target)
    return target
