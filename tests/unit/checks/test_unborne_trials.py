"""Steps that no knee would bear are not offered by `design`."""

from typing import Any

import pytest
from held import both_of

import identknee as ik
from identknee.checks.unborne_trials import FARTHEST
from identknee.laxity.protocol import concatenate
from identknee.subject.plausibility import STRENGTHS

KNEE = ik.reference_knee()
TRIALS = dict(zip((SEED := ik.load_protocol("seed63")).trials, range(SEED.n), strict=True))
PLAN = SEED.select(
    [TRIALS[f"flexion0_{x}"] for x in ("unloaded", "internal10Nm", "varus10Nm", "varus-10Nm")]
)
# The model stretches the LCL beyond its strength here, and in no trial of the plan.
PULLED = SEED.select([TRIALS["flexion0_internal-10Nm"]])
OFFERED = concatenate([PLAN, PULLED], name="offered")
ASKED: dict[str, Any] = {
    "n_trials": 1,
    "targets": ["LCL.stiffness_kN"],
    "fixed": [*both_of("ACL", "PCL", "MCL"), "LCL.reference_strain_pct"],
    "candidates": OFFERED,
}


@pytest.fixture(scope="module")
def planned() -> ik.Design:
    return ik.design(KNEE, protocol=PLAN, noise="0.5mm,0.5deg", **ASKED)


def test_what_would_tear_a_ligament_is_left_out_with_its_load(planned: ik.Design) -> None:
    (name,) = PULLED.trials
    assert planned.choice.names == PLAN.trials
    assert not [x for x in planned.choice.steps if x.trial == name]
    (own,) = [x for x in planned.unborne if x.trial == name]
    strength = STRENGTHS["LCL"][0]
    found = ik.simulate(KNEE, PULLED).tension_N[0]
    assert own.what == "LCL"
    assert own.limit == strength < own.value == pytest.approx(max(found))
    (said,) = [x for x in planned.findings if x.code == "step-beyond-strength"]
    assert said.values["n"] == sum(x.what == "LCL" for x in planned.unborne)
    assert {"trial", "ligament", "force_N"} <= set(said.values)


def test_a_cut_after_which_the_tibia_goes_too_far_is_left_out(planned: ik.Design) -> None:
    name = "flexion0_internal10Nm without LCL"
    (own,) = [x for x in planned.unborne if x.trial == name]
    assert (own.what, own.limit) == ("internal_deg", FARTHEST["internal_deg"])
    assert own.value > own.limit
    cuts = {x.name for x in planned.choice.steps if x.kind == "cut"}
    assert name not in cuts
    assert "flexion0_internal10Nm without ACL" in cuts
    (said,) = [x for x in planned.findings if x.code == "step-beyond-laxity"]
    assert said.values["change_deg"] >= own.value
    assert name in said.values["trials"]


def test_what_the_knee_bore_is_offered_again() -> None:
    made = ik.simulate(KNEE, OFFERED).laxity
    answer = ik.design(KNEE, made, noise="0.5mm,0.5deg", cost="cut=never", **ASKED)
    assert answer.choice.names == OFFERED.trials
    assert answer.unborne == ()


def test_nothing_bearable_is_a_mistake_of_the_candidates() -> None:
    with pytest.raises(ValueError, match="smaller loads"):
        ik.design(KNEE, protocol=PLAN, noise="0.5mm,0.5deg", **{**ASKED, "candidates": PULLED})
