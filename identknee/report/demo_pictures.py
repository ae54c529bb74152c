"""The pictures that the demo leaves beside its results."""

from pathlib import Path

from identknee.report.picture import png
from identknee.report.profile_figures import profiles_figure
from identknee.report.scene import scene
from identknee.report.starts_figure import starts_figure
from identknee.runs.files import write_atomically
from identknee.subject.folder import read_subject
from identknee.verbs.demo import Demonstration


def write_demo_pictures(answer: Demonstration, folder: Path) -> None:
    """Write the starts, the profiles and the knee as PNGs."""
    figures = {
        "starts": starts_figure(answer.starts),
        "profiles": profiles_figure(tuple(answer.profiles.values())),
        "knee": scene(read_subject(answer.subject)),
    }
    for name, figure in figures.items():
        write_atomically(folder / f"{name}.png", png(figure))
