"""Trials to choose from: all kinds, no two alike, repeats under their own names."""

import numpy as np

from identknee.laxity.protocol import (
    COMBINED,
    FLEXION_DEG,
    LOADS,
    SINGLE,
    Protocol,
    candidate_trials,
    load_protocol,
    unique_names,
)


def test_every_trial_made_comes_first_as_its_repeat() -> None:
    made = load_protocol("seed63")
    found = candidate_trials(made)
    assert found.trials[:63] == made.trials
    np.testing.assert_array_equal(found.loads[:63], made.loads)


def test_no_two_have_the_same_angle_and_loads() -> None:
    made = load_protocol("seed63")
    found = candidate_trials(made)
    rows = np.column_stack([found.flexion_deg, found.loads])
    assert len(np.unique(rows, axis=0)) == found.n
    shared = {tuple(x) for x in np.column_stack([made.flexion_deg, made.loads]).tolist()}
    per_angle = len(SINGLE) + len(COMBINED)
    new = [x for x in rows.tolist() if tuple(x) not in shared]
    assert len(new) == found.n - 63
    # Unloaded, two moments about each of two axes: of seed63's angles these are made already.
    assert found.n == 63 + per_angle * len(FLEXION_DEG) - 5 * 3


def test_there_are_loads_of_every_kind_and_pairs_of_them() -> None:
    found = candidate_trials(load_protocol("seed63"), [90])
    new = found.loads[63:]
    assert set(np.flatnonzero(new.any(axis=0))) == {0, 1, 2, 3}
    assert set((new != 0).sum(axis=1)) == {0, 1, 2}
    assert new[:, LOADS.index("distraction_force_N")].min() < 0
    assert (found.flexion_deg[63:] == 90).all()


def test_a_name_taken_by_other_loads_is_not_used_again() -> None:
    odd = Protocol(
        name="odd",
        trials=("flexion0_internal5Nm",),
        flexion_deg=np.array([0.0]),
        loads=np.array([[1.0, 0, 0, 0, 0]]),
    )
    found = candidate_trials(odd, [0])
    assert found.trials[0] == "flexion0_internal5Nm"
    assert "flexion0_internal5Nm_new" in found.trials
    # Asked for again with these as the trials made, all of them are repeats.
    assert candidate_trials(found, [0]).trials == found.trials


def test_repeats_get_numbers() -> None:
    assert unique_names(["a", "a", "b"], ["a"]) == ("a_repeat2", "a_repeat3", "b")
    assert unique_names(["a"], ["a", "a_repeat2"]) == ("a_repeat3",)
