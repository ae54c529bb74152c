"""The knee of a subject's results, ready to be turned."""

from identknee.calibrate.starts import load_start
from identknee.model.laxity_model import LaxityModel
from identknee.report.page.knee_scene import KneeScene, model_scene
from identknee.report.page.results import Findings, Result
from identknee.runs.arrays import Array
from identknee.subject.folder import read_subject
from identknee.subject.knee import Knee
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.simulate import SimulatedLaxity

EXTENDED, FITTED = "extended", "fitted.toml"


def scene_of(findings: Findings, knee: Knee) -> KneeScene | None:
    """The knee as a diagnosis extended it, else as it was fitted, else as it was simulated.

    None where no result says in which trials it is loaded.

    Parameters
    ----------
    findings
        The results of one subject.
    knee
        That subject.
    """
    for result in findings.of("diagnose", "fit", "demo", "simulate"):
        protocol = result.protocol
        if protocol is None:
            continue
        extended = result.folder / EXTENDED
        if result.verb == "diagnose" and extended.is_dir():
            model = LaxityModel(knee=read_subject(extended), protocol=protocol)
            theta = load_start(str(extended / FITTED), model.parameters)
            return model_scene(model, theta, missing_line=_line(result, model.knee))
        if isinstance(result.answer, SimulatedLaxity):
            model = LaxityModel(knee=knee, protocol=protocol)
            if result.answer.parameter_names == model.parameters.names:
                return model_scene(model, result.answer.theta)
    return None


def _line(result: Result, knee: Knee) -> Array | None:
    """Ends of the missing line of action in the common frame [mm]; None where there is none."""
    line = result.answer.line if isinstance(result.answer, Diagnosis) else None
    return line.in_common_frame(knee) if line is not None and line.is_line else None
