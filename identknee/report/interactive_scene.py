"""The knee in three dimensions outside the report: in a notebook, or as a page of its own."""

from dataclasses import dataclass, field
from pathlib import Path

from markupsafe import escape

from identknee.calibrate.starts import load_start
from identknee.laxity.named_trials import TrialsLike, read_tests
from identknee.model.model_for_tests import model_for_tests
from identknee.report.notebook import result_of
from identknee.report.page.markup import document
from identknee.report.page.results import Findings
from identknee.report.page.viewer import model_scene, scene_of, viewer_html
from identknee.runs.files import PathLike, write_atomically
from identknee.subject.knee import Knee
from identknee.verbs.answer import Answer

HEIGHT = "720"


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene3D:
    """The knee as a page to turn it on, trial by trial; a notebook shows it.

    Attributes
    ----------
    html
        The page. It needs no network, so it holds all of plotly: 5 MB.
    """

    html: str = field(repr=False)

    def write(self, path: PathLike) -> Path:
        """The file `path`, written for a browser."""
        return write_atomically(Path(path), self.html)

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{escape(self.html)}" title="The knee in three dimensions" '
            f'width="100%" height="{HEIGHT}" style="border: 0"></iframe>'
        )


def scene_3d(
    knee: Knee, answer: Answer | None = None, *, protocol: TrialsLike = "seed63"
) -> Scene3D:
    """The knee in three dimensions, with ligament forces and contact in every trial.

    Parameters
    ----------
    knee
        The subject.
    answer
        A fit, a simulation or a diagnosis of it: its parameters are shown. Those of the subject if
        None.
    protocol
        The trials to show where there is no answer: a protocol, the name of one, its TOML file, or
        a laxity table.

    Raises
    ------
    ValueError
        If the answer says nothing about this knee's poses.
    """
    if answer is None:
        model = model_for_tests(knee, read_tests(protocol))
        scene = model_scene(model, load_start("subject", model.parameters))
    elif found := scene_of(Findings(subject=knee.name, results=(result_of(answer),)), knee):
        scene = found
    else:
        raise ValueError(
            f"{type(answer).__name__} holds no poses of this knee; give a fit, a simulation or "
            "a diagnosis of it, or no answer"
        )
    return Scene3D(html=document(f"Knee {knee.name}", viewer_html(scene), has_viewer=True))
