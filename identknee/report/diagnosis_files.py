"""The figures of a diagnosis as files."""

from pathlib import Path

from identknee.diagnosis.isolability import Distances
from identknee.report.diagnosis_figures import diagnosis_figures, isolability_figure
from identknee.report.picture import png
from identknee.runs.files import write_atomically
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.isolability import Isolability


def write_diagnosis_figures(answer: Diagnosis | Isolability, knee: Knee, out: Path) -> None:
    """Write all figures; all are drawn before any is written, so that no half of them is left."""
    if isinstance(answer, Isolability):
        figures = {"isolability": isolability_figure(distances_of(answer))}
    else:
        figures = diagnosis_figures(answer, knee)
    pictures = {name: png(x) for name, x in figures.items()}
    for name, picture in pictures.items():
        write_atomically(out / f"{name}.png", picture)


def distances_of(answer: Isolability) -> Distances:
    """The distances of all causes from one another."""
    return Distances(effects=answer.rivals, rivals=answer.rivals, values=answer.distances)
