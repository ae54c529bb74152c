"""The knee in three dimensions outside the report: in a notebook, or as a page of its own."""

from dataclasses import dataclass, field
from pathlib import Path

from identknee.calibrate.fit import load_start
from identknee.laxity.table import TrialsLike, read_tests
from identknee.model.laxity_model import model_for_tests
from identknee.report.notebook import result_of
from identknee.report.page.markup import element
from identknee.report.page.page import document
from identknee.report.page.results import Findings
from identknee.report.page.viewer import KneeScene, model_scene, scene_of, viewer_html
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
        return element(
            "iframe",
            "",
            srcdoc=self.html,
            title="The knee in three dimensions",
            width="100%",
            height=HEIGHT,
            style="border: 0",
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
    scene = _of_subject(knee, protocol) if answer is None else _of_answer(knee, answer)
    return Scene3D(html=document(f"Knee {knee.name}", viewer_html(scene), has_viewer=True))


def _of_subject(knee: Knee, protocol: TrialsLike) -> KneeScene:
    model = model_for_tests(knee, read_tests(protocol))
    return model_scene(model, load_start("subject", model.parameters))


def _of_answer(knee: Knee, answer: Answer) -> KneeScene:
    result = result_of(answer)
    scene = scene_of(Findings(subject=knee.name, results=(result,)), knee)
    if scene is None:
        raise ValueError(
            f"{type(answer).__name__} holds no poses of this knee; give a fit, a simulation or "
            "a diagnosis of it, or no answer"
        )
    return scene
