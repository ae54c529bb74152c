"""Cuts and measured forces as steps that may follow: states, trials, values and derivatives."""

from dataclasses import replace

import numpy as np
import pytest

import identknee as ik
from identknee.laxity.protocol import concatenate
from identknee.model.candidate_laxity import (
    CONTACT_SD,
    TENSION_SD,
    CandidateLaxity,
    candidate_forces,
    current_state,
    laxity_after_cuts,
    strongest_trials,
    structures_left,
    with_state,
)
from identknee.model.contact_loads import contact_values
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import structure_values

KNEE = ik.reference_knee()
MADE = ik.load_protocol("seed63")
SD = np.full(5, 0.5)


def _offered(made: ik.Protocol = MADE) -> CandidateLaxity:
    model = LaxityModel(knee=KNEE, protocol=made)
    laxity = model.simulate(model.parameters.start)
    free = model.parameters.with_fixed(["PCL.stiffness_kN"], model.parameters.start)
    return CandidateLaxity(model=model, laxity=laxity, protocol=MADE, sd=SD, free=free)


def test_the_knee_is_left_in_the_state_with_the_most_cuts() -> None:
    assert current_state(MADE) == "intact"
    states = ("intact",) * 30 + ("cut: ACL, LCL",) * 20 + ("cut: ACL",) * 13
    assert current_state(replace(MADE, state=states)) == "cut: ACL, LCL"


def test_the_strongest_trials_have_one_load_and_no_larger_one_beside_them() -> None:
    chosen = strongest_trials(MADE)
    assert set(np.abs(chosen.loads).max(axis=1)) == {10.0}
    assert chosen.n == 12


def test_a_cut_leaves_the_structures_beside_it() -> None:
    offered = _offered()
    after = laxity_after_cuts(offered, "cut: ACL")
    assert [x.ligament for x in after] == ["PCL", "LCL", "MCL"]
    states = {x.laxity.protocol.state for x in after}
    assert {x[0] for x in states if x} == {"cut: ACL, PCL", "cut: ACL, LCL", "cut: ACL, MCL"}
    assert all(y.endswith(f" without {x.ligament}") for x in after for y in x.laxity.names)
    assert structures_left(offered.model, "cut: ACL, MCL 50%") == ("PCL", "LCL", "MCL")
    # Nothing holds a knee whose last ligament is cut.
    assert laxity_after_cuts(offered, "cut: ACL, PCL, LCL") == ()


def test_trials_after_a_cut_are_those_of_a_model_without_the_ligament() -> None:
    offered = _offered()
    mcl = next(x.laxity for x in laxity_after_cuts(offered, "intact") if x.ligament == "MCL")
    values, jacobians = mcl.predict(offered.free.parameters.start, range(len(mcl.names)))
    without = KNEE.with_ligaments([x for x in KNEE.ligaments if x.name != "MCL"])
    plain = replace(mcl.protocol, state=None)
    model = LaxityModel(knee=without, protocol=plain)
    expected = model.predict(model.parameters.start).coordinates / SD
    known = np.isfinite(values).all(axis=1)
    assert known.sum() >= 10
    np.testing.assert_allclose(values[known], expected[known], atol=1e-8)
    assert not jacobians[:, :, 2][known].any()  # MCL stiffness, with the PCL's held


@pytest.mark.parametrize("has_contact", [True, False])
def test_forces_are_those_of_the_trial_in_units_of_their_errors(has_contact: bool) -> None:
    offered = _offered()
    forces = candidate_forces(offered, "intact", has_tensions=True, has_contact=has_contact)
    names = forces.names
    assert len(names) == 12 * (4 + has_contact)
    theta = np.asarray(offered.free.parameters.start)
    chosen = [3, 0, 3, len(names) - 1]
    values, jacobians = forces.predict(theta, chosen)
    model = forces.model
    found = model.predict(offered.free.expand(theta))
    for row, (trial, structure) in zip(values, [forces.places[i] for i in chosen], strict=True):
        if structure:
            tension = structure_values(model, found, structure)[0][trial]
            np.testing.assert_allclose(row, [tension / TENSION_SD, 0.0])
        else:
            np.testing.assert_allclose(row, contact_values(found)[trial, :, 0] / CONTACT_SD)
    for j in range(theta.size):
        step = np.zeros(theta.size)
        step[j] = 1e-5 * max(abs(theta[j]), 1.0)
        ends = [forces.predict(theta + sign * step, chosen)[0] for sign in (1.0, -1.0)]
        slopes = (ends[0] - ends[1]) / (2.0 * step[j])
        np.testing.assert_allclose(jacobians[:, :, j], slopes, atol=1e-6 * np.abs(jacobians).max())


def test_what_is_cut_has_no_tension_to_measure() -> None:
    cut = with_state(replace(MADE, trials=tuple(f"{x}_c" for x in MADE.trials)), "cut: MCL")
    offered = _offered(concatenate([MADE, cut]))
    forces = candidate_forces(offered, "cut: MCL", has_tensions=True, has_contact=False)
    assert forces.structures == ("ACL", "PCL", "LCL")
    assert set(forces.model.protocol.state or ()) == {"cut: MCL"}
