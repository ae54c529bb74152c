"""Ends that the data leave open, with the priors of ligament parameters."""

import numpy as np
import pytest
from held import both_of

import identknee as ik
from identknee.identify.profile.result import EndOrigin, ProfileVerdict
from identknee.verbs.profile import Profiles

NOISE = "0.5mm,0.5deg"
HELD = both_of("PCL", "LCL")
# Of the ends: profiles end to 1e-3 of the threshold.
RELATIVE = 2e-3


@pytest.fixture(scope="module")
def laxity() -> ik.Laxity:
    """Three trials in which a posterior force leaves the anterior cruciate slack, with noise."""
    protocol = ik.load_protocol("drawer").select([0, 3, 6])
    made = ik.simulate(ik.reference_knee(), protocol).laxity
    return ik.add_noise(made, sd_mm=0.5, sd_deg=0.5, seed=1)


@pytest.fixture(scope="module")
def found(laxity: ik.Laxity) -> Profiles:
    """The stiffness and strain of a ligament that carries nothing, and of one that does."""
    names = ["ACL.stiffness_kN", "ACL.reference_strain_pct", "MCL.reference_strain_pct"]
    return ik.profile("reference", laxity, noise=NOISE, fixed=HELD, parameters=names)


def test_where_the_data_say_nothing_the_priors_make_the_ends(found: Profiles) -> None:
    """Lognormal around 10 kN with 0.35, and normal around 8 % with 2 %."""
    assert found.parameters["ACL.stiffness_kN"].verdict is not ProfileVerdict.IDENTIFIABLE
    stiffness, strain = (
        found.with_priors[f"ACL.{x}"] for x in ("stiffness_kN", "reference_strain_pct")
    )
    expected = 10.0 * np.exp(0.35 * 1.959964 * np.array([-1.0, 1.0]))
    assert [stiffness.lower, stiffness.upper] == pytest.approx(expected, rel=RELATIVE)
    assert stiffness.lower_side.made_by is EndOrigin.PRIOR
    assert stiffness.verdict is ProfileVerdict.BOUNDED_BY_ASSUMPTION
    # Tighter from above, the ligament would bear.
    assert strain.lower == pytest.approx(8.0 - 2.0 * 1.959964, rel=RELATIVE)


def test_what_the_data_bound_is_asked_once(found: Profiles, laxity: ik.Laxity) -> None:
    assert found.parameters["MCL.reference_strain_pct"].verdict is ProfileVerdict.IDENTIFIABLE
    assert set(found.with_priors) == {"ACL.stiffness_kN", "ACL.reference_strain_pct"}
    for asked in (True, False):
        one = ik.profile(
            "reference",
            laxity,
            noise=NOISE,
            fixed=HELD,
            parameters=["ACL.stiffness_kN"],
            priors=asked,
        )
        assert one.with_priors == {}
        own = one.parameters["ACL.stiffness_kN"]
        assert (own.verdict is ProfileVerdict.BOUNDED_BY_ASSUMPTION) == asked
    assert found.question is not None
    assert not found.question.priors
