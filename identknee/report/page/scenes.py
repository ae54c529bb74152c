"""The knee of a subject's results, ready to be turned."""

import numpy as np

from identknee.calibrate.starts import load_start
from identknee.model.laxity_model import LaxityModel
from identknee.report.page.knee_scene import KneeScene, model_scene
from identknee.report.page.results import Findings
from identknee.report.presenter import presenter_of
from identknee.subject.folder import read_subject
from identknee.subject.knee import Knee

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
            line = presenter_of(result.answer).missing_line(result.answer, model.knee)
            return model_scene(model, theta, missing_line=line)
        if (values := result.answer.parameter_set) is not None:
            model = LaxityModel(knee=knee, protocol=protocol)
            if tuple(values) == model.parameters.names:
                return model_scene(model, np.array(list(values.values())))
    return None
