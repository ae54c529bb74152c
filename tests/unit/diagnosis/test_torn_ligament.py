"""A ligament that carries nothing: the model fits, and the ligament is named."""

from functools import cache

import numpy as np
import pytest

from identknee.checks.fit_checks import ligament_findings, ligament_loads
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import STIFFNESS
from identknee.subject.reference import reference_knee
from identknee.verbs.diagnosis import implausible_explanation

TORN, LEFT, SD = "MCL", 0.02, 0.3


@cache
def torn() -> Investigation:
    """The diagnosis of laxity with a fiftieth of the medial collateral's stiffness."""
    knee = reference_knee()
    model = LaxityModel(knee=knee, protocol=load_protocol("seed63"))
    theta = np.array(model.parameters.center)
    theta[model.parameters.index(f"{TORN}.{STIFFNESS}")] *= LEFT
    laxity = add_noise(model.simulate(theta), sd_mm=SD, sd_deg=SD, seed=3)
    found = investigate(knee, laxity)
    assert found is not None
    return found


def test_a_torn_ligament_is_no_misfit() -> None:
    found = torn()
    assert found.conclusion.verdict is Verdict.ADEQUATE
    assert found.base.misfit_p_value > 0.05
    # Its prior is far from where the data put it, and that is all that is improbable.
    fitted = found.base.fitted
    assert fitted.deviance - found.base.misfit_chi2 > 50.0


def test_it_is_named_and_asked_for_no_strain() -> None:
    found = torn()
    named = [x for x in found.findings if x.code == "ligament-idle"]
    assert [x.where for x in named] == [TORN]
    force, expected = (named[0].values[x] for x in ("force_N", "prior_force_N"))
    assert isinstance(force, float)
    assert isinstance(expected, float)
    assert force < 0.05 * expected
    assert not [x for x in implausible_explanation(found) if x.code == "implausible-strain"]


def test_only_its_own_prior_is_left_out_of_the_scores() -> None:
    fitted = torn().base.fitted
    left_out = np.flatnonzero(~fitted.is_scored) - fitted.n_data
    names = [fitted.model.parameters.names[i] for i in left_out]
    assert names == [f"{TORN}.{STIFFNESS}", f"{TORN}.reference_strain_pct"]
    assert (~fitted.counts_as_misfit).sum() == fitted.model.n_ligament_parameters


@pytest.mark.parametrize(("log_shift", "codes"), [
    (0.0, []),
    (1.0, []),  # 2.9 standard deviations
    (1.5, ["ligament-beyond-prior"]),
])  # fmt: skip
def test_a_ligament_that_carries_load_may_be_far_from_its_prior(
    log_shift: float, codes: list[str]
) -> None:
    knee = reference_knee()
    model = LaxityModel(knee=knee, protocol=load_protocol("seed63"))
    theta = np.array(model.parameters.center)
    theta[model.parameters.index(f"PCL.{STIFFNESS}")] *= np.exp(log_shift)
    prediction = model.predict(theta, derivatives=False)
    assert prediction.is_converged.all()
    assert [x.code for x in ligament_findings(model, prediction)] == codes
    assert not any(x.is_idle for x in ligament_loads(model, prediction))
