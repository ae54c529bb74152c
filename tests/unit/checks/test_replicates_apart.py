"""Equal trials that differ by more than noise are named, and sound tables are not accused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from identknee.checks.data_noise import replicates_findings
from identknee.checks.left_out_trials import trials_asked
from identknee.laxity.protocol import Protocol, load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.subject.reference import reference_knee


@cache
def simulated(left: float) -> Laxity:
    """Drawer with a share of the ACL's stiffness."""
    model = LaxityModel(knee=reference_knee(), protocol=load_protocol("drawer"))
    theta = np.array(model.parameters.center)
    theta[model.parameters.index("ACL.stiffness_kN")] *= left
    return model.simulate(theta)


def two_in_one(other: Laxity, *, sd: float = 0.3, state: tuple[str, ...] | None = None) -> Laxity:
    """The intact knee and another one in one table."""
    first = simulated(1.0)
    protocol = Protocol(
        name="both",
        trials=tuple(f"{x}_{k}" for k in "ic" for x in first.protocol.trials),
        flexion_deg=np.tile(first.protocol.flexion_deg, 2),
        loads=np.tile(first.protocol.loads, (2, 1)),
        state=state,
    )
    values = np.concatenate([first.coordinates, other.coordinates])
    clean = Laxity(protocol=protocol, coordinates=values)
    return add_noise(clean, sd_mm=sd, sd_deg=sd, seed=1)


@pytest.mark.parametrize(("left", "is_stated"), [(0.0, True), (0.0, False), (0.1, True)])
def test_two_states_in_one_table_are_named(left: float, *, is_stated: bool) -> None:
    both = two_in_one(simulated(left))
    laxity = both if is_stated else replace(both, sd=None)
    (found,) = replicates_findings(laxity)
    assert found.code == "replicates-apart"
    assert [str(found.values[x])[-2:] for x in ("first", "second")] == ["_i", "_c"]
    assert 0 < found.values["n_apart"] <= found.values["n_repeated"] <= 9
    assert found.code in [x.code for x in trials_asked(laxity).findings]


def test_states_that_are_said_are_not_compared() -> None:
    state = ("intact",) * 9 + ("cut: ACL",) * 9
    assert replicates_findings(two_in_one(simulated(0.0), state=state)) == ()


@pytest.mark.parametrize("sd", [0.1, 0.3, 2.0])
def test_replicates_within_their_noise_are_sound(sd: float) -> None:
    laxity = two_in_one(simulated(1.0), sd=sd)
    assert replicates_findings(laxity) == ()
    assert replicates_findings(replace(laxity, sd=None), noise_mm=sd) == ()


def test_a_table_without_replicates_or_values_is_sound() -> None:
    one = simulated(1.0)
    assert replicates_findings(one) == ()
    assert replicates_findings(replace(one, coordinates=np.full((9, 5), np.nan))) == ()
