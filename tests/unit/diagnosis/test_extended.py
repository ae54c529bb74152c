"""The extended subject predicts what the fit predicted."""

from pathlib import Path

import numpy as np
import pytest
from diagnoses import FRAME, diagnosed, short_data
from posed_knees import posed_reference

from identknee.diagnosis.fitting import Refit
from identknee.diagnosis.investigation import investigate
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.subject.folder import read_subject, write_subject

# Ten times what the equilibrium solver leaves; the femur of a file is a mesh, as this one's is.
SOLVED = 1e-6


def _predicted(refit: Refit, folder: Path) -> np.ndarray:
    """What the extended subject, written and read again, predicts where the fit lies."""
    knee = read_subject(write_subject(refit.extended_knee, folder))
    model = LaxityModel(knee=knee, protocol=refit.fitted.laxity.protocol)
    values = {
        f"{owner}.{name}": x
        for owner, own in refit.fitted_values.items()
        for name, x in own.items()
    }
    assert model.parameters.names == refit.fitted.model.parameters.names
    return model.predict(model.parameters.vector(values)).coordinates


def test_a_posed_and_mirrored_knee_keeps_its_causes(tmp_path: Path) -> None:
    knee = read_subject(write_subject(posed_reference(1), tmp_path / "subject"))
    candidates = [effect_named(knee, x) for x in (FRAME, "flexion_offset")]
    found = investigate(knee, short_data(knee, FRAME), effects=candidates)
    assert found is not None
    best = found.explanation
    assert FRAME in found.conclusion.group
    np.testing.assert_allclose(
        _predicted(best, tmp_path / "extended"),
        best.fitted.model.predict(best.fitted.theta).coordinates,
        atol=SOLVED,
    )


def test_amplitudes_are_the_subjects_own_and_ligaments_as_before() -> None:
    found = diagnosed(FRAME)
    best = found.explanation
    extended = best.extended_knee
    own = LaxityModel(knee=extended, protocol=found.laxity.protocol).parameters
    n = best.n_base - 2
    np.testing.assert_array_equal(own.start[:n], best.fitted.model.parameters.center[:n])
    for name in best.names:
        places = [own.index(x) for x in own.names if x.startswith(f"{name}.")]
        assert own.start[places] == pytest.approx(best.amplitudes(name), rel=1e-12)
