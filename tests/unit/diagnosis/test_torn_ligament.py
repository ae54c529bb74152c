"""A ligament that carries nothing: the model fits, and the ligament is named."""

from functools import cache

import numpy as np
import pytest
from slow_cases import some_slow
from verdict_cases import torn_outcome

import identknee as ik
from identknee.checks.fit_checks import idle_parameters, ligament_findings, ligament_loads
from identknee.diagnosis.base_fit import WIDER_IF_IDLE, fit_base, without_idle_priors
from identknee.diagnosis.fitting import FittedModel, without_causes
from identknee.diagnosis.investigation import Investigation, investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import STIFFNESS, STRAIN
from identknee.runs.record import Outcome
from identknee.subject.reference import reference_knee
from identknee.verbs.diagnose import implausible_explanation

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
    # It had no stiffness and no length that its prior could tell.
    prior = LaxityModel(knee=reference_knee(), protocol=load_protocol("seed63")).parameters
    own, fitted = found.base.fitted.model.parameters, found.base.fitted
    wider = own.prior_sd[: prior.n] / prior.prior_sd
    torn_ones = [TORN in x for x in prior.names]
    np.testing.assert_allclose(wider, np.where(torn_ones, WIDER_IF_IDLE, 1.0))
    np.testing.assert_array_equal(own.center[: prior.n], prior.center)
    assert fitted.outcome is Outcome.MINIMUM


def without(ligament: str, protocol: str = "seed63") -> Laxity:
    """Laxity of the knee without one ligament, in the trials in which it is stable."""
    model = LaxityModel(knee=reference_knee(), protocol=load_protocol(protocol))
    theta = np.array(model.parameters.center)
    theta[model.parameters.index(f"{ligament}.{STIFFNESS}")] = 0.0
    return add_noise(model.simulate(theta), sd_mm=SD, sd_deg=SD, seed=1)


@pytest.mark.slow
def test_no_bound_limits_what_is_absent() -> None:
    found = investigate(reference_knee(), without("ACL"))
    assert found is not None
    p, theta = found.base.fitted.model.parameters, found.base.fitted.theta
    assert theta[p.index(f"ACL.{STRAIN}")] == p.lower[p.index(f"ACL.{STRAIN}")]
    codes = [x.code for x in found.findings]
    assert "ligament-idle" in codes
    assert "at-bound" not in codes


@pytest.mark.parametrize("absent", some_slow(["ACL", "PCL", "LCL"], ["ACL", "PCL", "LCL"]))
def test_the_prior_of_an_absent_ligament_moves_the_knee_by_no_noise(absent: str) -> None:
    """Without it the knee is unstable in most trials, and cliffs bar the way to its stiffness."""
    begun = fit_base(reference_knee(), without(absent), starts=[], seed=0)
    assert begun is not None
    found = without_idle_priors(begun)
    fitted = found.fitted
    assert fitted.theta[fitted.model.parameters.index(f"{absent}.{STIFFNESS}")] < 1e-4
    assert not fitted.is_refuted.any()
    assert without_causes(found).misfit_p_value > 0.05


def test_a_prior_that_holds_a_torn_ligament_at_a_load_is_no_misfit() -> None:
    """Four trials in which the knee is stable: their fit is a minimum, and it is rejected."""
    begun = fit_base(reference_knee(), without("ACL", "drawer"), starts=[], seed=0)
    assert begun is not None
    assert (begun.fitted.outcome, begun.fitted.laxity.n_values) == (Outcome.MINIMUM, 20)
    assert "ACL" not in _idle_in(begun.fitted)
    assert without_causes(begun).misfit_p_value < 1e-3
    found = without_idle_priors(begun)
    assert _idle_in(found.fitted) == {"ACL"}
    assert without_causes(found).misfit_p_value > 0.05


def _idle_in(fitted: FittedModel) -> set[str]:
    loads = ligament_loads(fitted.model, fitted.model.predict_once(fitted.theta))
    return {x.name for x in loads if x.is_idle}


def test_the_extended_subject_keeps_its_own_priors() -> None:
    assert torn().extended_knee.priors == reference_knee().priors


def test_it_is_named_and_asked_for_no_strain() -> None:
    found = torn()
    named = [x for x in found.findings if x.code == "ligament-idle"]
    assert [x.where for x in named] == [TORN]
    force, expected = (named[0].values[x] for x in ("force_N", "prior_force_N"))
    assert isinstance(force, float)
    assert isinstance(expected, float)
    assert force < 0.05 * expected
    assert not [x for x in implausible_explanation(found) if x.code == "implausible-strain"]


def test_a_refuted_prior_is_neither_misfit_nor_scored() -> None:
    """Before it is widened; it is then no longer refuted."""
    knee = reference_knee()
    fitted = fit_base(knee, torn().laxity, starts=[], seed=0)
    assert fitted is not None
    base = without_causes(fitted)
    assert base.misfit_p_value > 0.05
    assert fitted.fitted.deviance - base.misfit_chi2 > 50.0
    left_out = np.flatnonzero(~fitted.fitted.is_scored) - fitted.fitted.n_data
    names = [fitted.fitted.model.parameters.names[i] for i in left_out]
    assert names == [f"{TORN}.{STIFFNESS}", f"{TORN}.{STRAIN}"]
    assert torn().base.fitted.is_scored.all()


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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [180_003, 180_007])
def test_a_knee_that_folds_without_its_ligament_is_adequate(seed: int) -> None:
    """At the truth itself trials are lost: contact of the separate generator differs a little."""
    found = torn_outcome("lenhart2015_stable", seed)
    assert found["named"]
    assert found["verdict"] == Verdict.ADEQUATE.value


def test_a_fit_names_what_carries_nothing_and_no_bound_of_it() -> None:
    found = ik.fit("reference", without("ACL"), weighting="noise", more_starts=0)
    assert [x.where for x in found.findings if x.code == "ligament-idle"] == ["ACL"]
    limited = [p for x in found.findings if x.code == "at-bound" for p in x.values["parameters"]]
    assert not [x for x in limited if x.startswith("ACL.")]
    model = LaxityModel(knee=reference_knee(), protocol=without("ACL").protocol)
    prediction = model.predict(found.theta, derivatives=False)
    assert idle_parameters(model, prediction) == (f"ACL.{STIFFNESS}", f"ACL.{STRAIN}")
