"""What a diagnosis leaves in a folder: the extended subject, trials to measure, its figures."""

from pathlib import Path

import numpy as np

from identknee.diagnosis.diagnose import Diagnosis
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity, write_laxity
from identknee.report.diagnosis_figures import diagnosis_figures
from identknee.report.picture import png
from identknee.runs.files import write_atomically
from identknee.subject.folder import write_subject

EXTENDED, FITTED, ADVICE = "extended", "fitted.toml", "advised_trials.csv"


def write_diagnosis_files(diagnosis: Diagnosis, out: Path) -> None:
    """Write figures, the extended subject, where its fit lies, and the trials to add.

    All figures are drawn before any is written, so that no half of them is left.
    """
    pictures = {name: png(figure) for name, figure in diagnosis_figures(diagnosis).items()}
    for name, picture in pictures.items():
        write_atomically(out / f"{name}.png", picture)
    folder = write_subject(diagnosis.extended_knee, out / EXTENDED)
    lines = ["# Where the fit of the extended model lies: --start of other verbs."]
    for owner, values in diagnosis.explanation.fitted_values.items():
        lines += ["", f"[{owner}]", *(f"{name} = {value!r}" for name, value in values.items())]
    write_atomically(folder / FITTED, "\n".join(lines) + "\n")
    if diagnosis.advice is not None:
        write_laxity(_blank(diagnosis.laxity, diagnosis.advice.trials), out / ADVICE)


def _blank(laxity: Laxity, trials: Protocol) -> Laxity:
    """Trials to measure, their coordinates to be filled in."""
    return Laxity(
        protocol=trials,
        coordinates=np.full((trials.n, laxity.coordinates.shape[1]), np.nan),
        zero=laxity.zero,
        comments=("Trials advised by identknee diagnose: measure, fill in, append to the data.",),
    )
