"""States of a knee that the table mislabels: cuts not made, made elsewhere, or exchanged."""

from dataclasses import replace

import numpy as np
import pytest

import identknee as ik
from identknee.checks.broken_convention import conventions_of, find_broken_convention
from identknee.laxity.experiments import Experiment
from identknee.laxity.protocol import Protocol, concatenate
from identknee.model.laxity_model import LaxityModel

BASE = ik.load_protocol("drawer")
LIGAMENTS = ("ACL", "PCL", "LCL", "MCL")


def protocol_in(*states: str) -> Protocol:
    """Every fourth rotation of seed63 below 60 deg and the drawer trials in each state."""
    both = concatenate([ik.load_protocol("seed63").select(range(0, 63, 4)), BASE], name="both")
    kept = both.select(np.flatnonzero(both.flexion_deg < 60.0))
    return concatenate(
        [
            replace(
                kept,
                trials=tuple(f"{x}_{k}" for x in kept.trials),
                state=(state,) * kept.n,
            )
            for k, state in enumerate(states)
        ],
        name="states",
    )


def labelled(made: tuple[str, ...], said: tuple[str, ...], seed: int) -> ik.Laxity:
    """Laxity of a knee in the states `made`, of the trials that are stable, labelled `said`."""
    model = LaxityModel(knee=ik.reference_knee(), protocol=protocol_in(*made))
    own = model.parameters
    draws = np.random.default_rng(seed).standard_normal(own.n)
    theta = np.where(own.is_log, own.center * np.exp(0.2 * draws), own.center + draws)
    laxity = model.simulate(theta)
    laxity = laxity.select(np.flatnonzero(laxity.is_measured.all(axis=1)))
    state = tuple(said[int(x.rpartition("_")[2])] for x in laxity.protocol.trials)
    laxity = replace(laxity, protocol=replace(laxity.protocol, state=state))
    return ik.add_noise(laxity, sd_mm=0.5, sd_deg=0.5, seed=seed)


@pytest.mark.parametrize(
    ("made", "said", "what"),
    [
        (
            ("intact", "intact"),
            ("intact", "cut: ACL"),
            'taking the trials of the state "cut: ACL" for "intact"',
        ),
        pytest.param(
            ("intact", "cut: ACL"),
            ("cut: ACL", "intact"),
            'exchanging the states "cut: ACL" and "intact"',
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_wrong_state_is_named(made: tuple[str, ...], said: tuple[str, ...], what: str) -> None:
    laxity = labelled(made, said, seed=1)
    model = LaxityModel(knee=ik.reference_knee(), protocol=laxity.protocol)
    found = find_broken_convention(model, laxity, model.parameters.start)
    assert found is not None
    assert (found.what, found.others) == (what, ())


def test_right_states_are_not_accused() -> None:
    states = ("intact", "cut: ACL")
    laxity = labelled(states, states, seed=1)
    model = LaxityModel(knee=ik.reference_knee(), protocol=laxity.protocol)
    assert find_broken_convention(model, laxity, model.parameters.start) is None


def changed_states(protocol: Protocol) -> dict[str, tuple[str, ...]]:
    """What the changes of states make of the labels, by the change."""
    laxity = ik.Laxity(protocol=protocol, coordinates=np.zeros((protocol.n, 5)))
    return {x.what: x.states for x in conventions_of(laxity, LIGAMENTS) if x.states is not None}


def test_every_cut_may_not_have_been_made_or_made_elsewhere() -> None:
    protocol = replace(BASE, state=("intact",) * 4 + ("cut: ACL, LCL",) * (BASE.n - 4))
    said = {x[-1] for x in changed_states(protocol).values()}
    assert said == {
        "cut: LCL",
        "cut: ACL",
        "cut: LCL, PCL",
        "cut: LCL, MCL",
        "cut: ACL, PCL",
        "cut: ACL, MCL",
        "intact",
    }
    # The fraction of a partial cut is estimated, and no change leaves a knee without ligaments.
    partial = replace(protocol, state=("intact",) * 4 + ("cut: ACL 50%",) * (BASE.n - 4))
    assert changed_states(partial) == {}
    last = replace(protocol, state=("cut: ACL, LCL",) * 4 + ("cut: ACL, LCL, MCL",) * (BASE.n - 4))
    assert "cut: ACL, LCL, MCL, PCL" not in {y for x in changed_states(last).values() for y in x}
    assert changed_states(BASE) == {}


def test_states_are_labelled_anew_by_experiment() -> None:
    n = BASE.n
    experiments = tuple(Experiment(name=x, rig="rig", mounting="rig-1") for x in "ab")
    protocol = replace(
        BASE,
        state=("cut: ACL",) * n,
        experiment=("a",) * 4 + ("b",) * (n - 4),
        experiments=experiments,
    )
    found = changed_states(protocol)
    of_a = found['taking the trials of the state "cut: ACL" of a for "intact"']
    assert of_a == ("intact",) * 4 + ("cut: ACL",) * (n - 4)
    assert not any(x.startswith("exchanging the states") for x in found)
