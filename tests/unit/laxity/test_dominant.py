"""Which load a trial is about, in tables as a robot writes them."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
from large_inputs import many_trials

from identknee.diagnosis.investigation import trial_layout
from identknee.laxity.experiments import Experiment
from identknee.laxity.protocol import (
    ALIKE,
    SAME_FLEXION_DEG,
    Protocol,
    concatenate,
    dominant_loads,
    load_protocol,
    nominal_flexion,
    nominal_loads,
    opposite_pairs,
    shown_flexion,
)
from identknee.laxity.table import COORDINATES, Laxity, example_laxity
from identknee.laxity.trial_words import load_words
from identknee.runs.declare import Array


def test_stray_and_constant_loads_do_not_tell_trials_apart() -> None:
    laxity = example_laxity("s192803")
    sides = trial_layout(laxity).sides()
    for i, trial in enumerate(laxity.protocol.trials):
        kind = trial.split("_")[0]
        unit = "force" if kind in {"Anterior", "Posterior"} else "moment"
        expected = "no load" if kind == "FullExt" else f"{kind.lower()} {unit}"
        assert [name for name, side in sides.items() if side[i]] == [expected]
    assert set(trial_layout(laxity).flexion_deg) == {5.0, 36.0, 57.0, 87.0}


def _load_and_angle(words: str) -> tuple[float, str, float]:
    """The load and the angle that stand in these words, and what the load is."""
    found = re.fullmatch(r"([\d.]+) \S+ of (.+) at (\d+) deg", words)
    assert found is not None
    return float(found[1]), found[2], float(found[3])


def test_a_load_is_said_in_words() -> None:
    laxity = example_laxity("s192803")
    words = {t: load_words(laxity.protocol, i) for i, t in enumerate(laxity.protocol.trials)}
    assert _load_and_angle(words["Anterior_30"]) == (197.0, "anterior force", 36.0)
    assert _load_and_angle(words["Valgus_60"]) == (9.6, "valgus moment", 57.0)
    assert words["FullExt_0"].startswith("no load ")
    assert re.findall(r"\d+", words["FullExt_0"]) == ["5"]


def test_a_load_that_all_trials_hold_is_their_load_where_there_is_no_other() -> None:
    laxity = example_laxity("s192803")
    pulled = laxity.protocol.select(range(4))
    assert _load_and_angle(load_words(pulled, 1)) == (197.0, "anterior force", 36.0)
    one = load_words(laxity.protocol.select([8]), 0)
    assert _load_and_angle(one) == (7.45, "external moment", 4.0)


def test_exact_protocols_are_told_apart_as_they_are() -> None:
    protocol = concatenate([load_protocol("seed63"), load_protocol("drawer")])
    np.testing.assert_array_equal(nominal_loads(protocol), protocol.loads)
    np.testing.assert_array_equal(nominal_flexion(protocol), protocol.flexion_deg)


def test_opposite_trials_are_those_of_the_opposite_load_nearby() -> None:
    protocol = example_laxity("s192803").protocol
    pairs = {(protocol.trials[i], protocol.trials[j]) for i, j in opposite_pairs(protocol)}
    ends = (("Anterior", "Posterior"), ("Internal", "External"), ("Varus", "Valgus"))
    assert pairs == {(f"{a}_{x}", f"{b}_{x}") for a, b in ends for x in ("0", "30", "60", "90")}


def test_the_most_alike_of_many_opposite_trials_are_paired_first() -> None:
    protocol = many_trials(60, seed=4)
    found, flexion = dominant_loads(protocol), protocol.flexion_deg
    fitting = []
    for i, j in product(range(60), range(60)):
        is_opposite = found.axis[i] == found.axis[j] and found.size[i] > 0.0 > found.size[j]
        apart = abs(flexion[i] - flexion[j]) / SAME_FLEXION_DEG
        unlike = abs(found.size[i] + found.size[j]) / abs(found.size[j]) / ALIKE if i != j else 2.0
        if is_opposite and apart <= 1.0 and unlike <= 1.0:
            fitting.append((apart + unlike, i, j))
    pairs: set[tuple[int, int]] = set()
    for _, i, j in sorted(fitting):
        if not {i, j} & {x for pair in pairs for x in pair}:
            pairs.add((i, j))
    assert len(pairs) > 5
    assert {(i, j) for i, j in opposite_pairs(protocol).tolist()} == pairs


def _experiment(name: str) -> Experiment:
    return Experiment(name=name, rig=name, mounting=name)


def test_angles_read_a_little_apart_are_shown_as_one() -> None:
    table = example_laxity("s192803").protocol
    shown = shown_flexion(table)
    assert len(np.unique(table.flexion_deg)) > 20
    np.testing.assert_array_equal(np.unique(shown), [5.0, 36.0, 57.0, 87.0])
    assert np.abs(shown - table.flexion_deg).max() < 3.0
    # Also beside an experiment whose trials all have the same angle.
    many = 40
    set_angle = Protocol(
        name="set",
        trials=tuple(f"set{i}" for i in range(many)),
        flexion_deg=np.full(many, 30.0),
        loads=np.zeros((many, 5)),
        experiment=("rig",) * many,
        experiments=(_experiment("rig"),),
    )
    robot = replace(table, experiment=("robot",) * table.n, experiments=(_experiment("robot"),))
    both = shown_flexion(concatenate([robot, set_angle]))
    np.testing.assert_array_equal(both, [*shown, *set_angle.flexion_deg])


def test_many_angles_are_shown_together() -> None:
    def shown(*angles: float) -> Array:
        loads = np.zeros((len(angles), 5))
        names = tuple(f"trial{i}" for i in range(len(angles)))
        protocol = Protocol(name="x", trials=names, flexion_deg=np.array(angles), loads=loads)
        return shown_flexion(protocol)

    few = [0.0, 0.0, 30.0, 30.0, 34.0, 34.0]
    np.testing.assert_array_equal(shown(*few), few)
    many = shown(*np.linspace(0.0, 90.0, 51).tolist())
    np.testing.assert_array_equal(np.unique(many), np.arange(0.0, 91.0, 15.0))


def test_a_ramp_under_constant_compression_is_about_its_own_load() -> None:
    protocol = load_protocol("seed63")
    loads = np.array(protocol.loads)
    loads[:, 3] = -50.0
    held = type(protocol)(
        name="held", trials=protocol.trials, flexion_deg=protocol.flexion_deg, loads=loads
    )
    np.testing.assert_array_equal(dominant_loads(held).axis, dominant_loads(protocol).axis)
    np.testing.assert_array_equal(nominal_loads(held)[:, :3], protocol.loads[:, :3])
    assert not nominal_loads(held)[:, 3].any()
    blank = np.full((held.n, len(COORDINATES)), np.nan)
    assert trial_layout(Laxity(protocol=held, coordinates=blank)).sides()["no load"].any()


def test_no_trial_has_no_load() -> None:
    none = load_protocol("drawer").select([])
    assert dominant_loads(none).axis.shape == (0,)
    assert nominal_loads(none).shape == (0, 5)
