"""Held-out folds of any protocol."""

import numpy as np
import pytest
from small_knee import small_protocol

from identknee import example_laxity
from identknee.diagnosis.gain import DIRECTION, EXTREMES, FLEXION, Fold, held_out_folds
from identknee.laxity.protocol import LOADS, Protocol, load_protocol


def protocol(flexion: list[float], loads: list[list[int]]) -> Protocol:
    return Protocol(
        name="made",
        trials=tuple(f"trial {i}" for i in range(len(flexion))),
        flexion_deg=np.array(flexion),
        loads=np.array(loads, float),
    )


def names(folds: tuple[Fold, ...], family: str) -> list[str]:
    return [x.name for x in folds if x.family == family]


def test_the_seed_protocol_has_three_angles_four_directions_and_the_extremes() -> None:
    trials = load_protocol("seed63")
    folds = held_out_folds(trials)
    assert names(folds, FLEXION) == ["0 deg", "30 deg", "60 deg"]
    assert names(folds, DIRECTION) == [
        "internal moment",
        "external moment",
        "varus moment",
        "valgus moment",
    ]
    assert [int(x.held.sum()) for x in folds] == [21, 21, 21, 15, 15, 15, 15, 24]
    (extreme,) = [x for x in folds if x.family == EXTREMES]
    assert np.array_equal(extreme.held, np.abs(trials.loads).max(axis=1) >= 8)
    varus = next(x for x in folds if x.name == "varus moment")
    assert np.array_equal(varus.held, trials.loads[:, LOADS.index("varus_moment_Nm")] > 0)


def test_a_trial_with_two_loads_is_held_out_for_either() -> None:
    trials = small_protocol()
    by_name = {
        x.name: [trials.trials[i] for i in np.flatnonzero(x.held)] for x in held_out_folds(trials)
    }
    assert by_name["0 deg"] == ["unloaded", "internal", "compressed"]
    assert by_name["varus moment"] == by_name["compression force"] == ["compressed"]
    assert by_name["external moment"] == by_name["medial force"] == ["medial"]
    assert "distraction force" not in by_name
    # 0.3 of 0.4 N m is less than 80 %, as 10 of 30 N.
    assert by_name["largest loads"] == ["internal", "valgus", "anterior"]


def test_angles_within_the_scatter_of_a_rig_are_one() -> None:
    trials = protocol([0.1, 29.8, 0.0, 30.0, 30.3], [[x, 0, 0, 0, 0] for x in (0, 1, 2, 0, 4)])
    held = [x.held.tolist() for x in held_out_folds(trials) if x.family == FLEXION]
    assert held == [[True, False, True, False, False], [False, True, False, True, True]]
    assert names(held_out_folds(trials), FLEXION) == ["0 deg", "30 deg"]


def test_a_robots_table_has_the_angles_that_were_meant_and_no_directions_of_stray_loads() -> None:
    trials = example_laxity("s192803").protocol
    folds = held_out_folds(trials)
    assert names(folds, FLEXION) == ["5 deg", "36 deg", "57 deg", "87 deg"]
    assert [int(x.held.sum()) for x in folds] == [7, 6, 6, 6, *6 * [4]]
    varus = next(x for x in folds if x.name == "varus moment")
    assert [x for x, held in zip(trials.trials, varus.held, strict=True) if held] == [
        "Varus_0",
        "Varus_30",
        "Varus_60",
        "Varus_90",
    ]


def test_one_angle_or_a_load_of_one_size_leave_nothing_to_learn_from() -> None:
    loads = [[0, 0, 0, -50, 0], [5, 0, 0, -50, 0], [-5, 0, 0, -50, 0]]
    folds = held_out_folds(protocol([30.0, 30.0, 30.0], loads))
    assert [x.name for x in folds] == ["internal moment", "external moment"]


def test_a_load_held_constant_does_not_make_its_trials_extreme() -> None:
    loads = [[x, 0, 0, -50, 0] for x in (0, 2, 4, 5, -5)]
    (extreme,) = [x for x in held_out_folds(protocol(5 * [0.0], loads)) if x.family == EXTREMES]
    assert extreme.held.tolist() == [False, False, True, True, True]


@pytest.mark.parametrize("held", [[True, True], [False, False]])
def test_a_fold_holds_out_some_trials_and_keeps_some(held: list[bool]) -> None:
    with pytest.raises(ValueError, match=rf"'odd'.* {sum(held)} of 2"):
        Fold(family=FLEXION, name="odd", held=np.array(held))
