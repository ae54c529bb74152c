"""Trials to choose from: all kinds, no two alike, repeats under their own names."""

from dataclasses import replace

import numpy as np
import pytest

from identknee.laxity.protocol import (
    COMBINED,
    FLEXION_DEG,
    LOADS,
    SINGLE,
    Protocol,
    candidate_trials,
    load_protocol,
    nominal_trials,
    unique_names,
)
from identknee.laxity.table import read_laxity


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


def _as_measured(made: Protocol, seed: int, stray: float = 0.02) -> Protocol:
    """The trials as a rig reads them: loads of all columns, angles and sizes with decimals."""
    rng = np.random.default_rng(seed)
    usual = np.array([5.0, 10.0, 100.0, 100.0, 100.0])
    return Protocol(
        name="measured",
        trials=tuple(f"m{i}" for i in range(made.n)),
        flexion_deg=made.flexion_deg + rng.uniform(0.1, 0.4, made.n),
        loads=made.loads + stray * usual * rng.uniform(-1.0, 1.0, made.loads.shape),
    )


@pytest.mark.parametrize("protocol", ["seed63", "drawer"])
def test_a_measured_trial_is_offered_as_it_was_meant(protocol: str) -> None:
    meant = load_protocol(protocol)
    found = candidate_trials(_as_measured(meant, 1), [])
    assert set(np.count_nonzero(found.loads, axis=1)) <= {0, 1}
    np.testing.assert_array_equal(found.flexion_deg, np.round(found.flexion_deg))
    assert set(found.flexion_deg) == set(meant.flexion_deg)
    # Of each direction the largest load.
    for axis in range(len(LOADS)):
        for sign in (-1.0, 1.0):
            sizes = sign * meant.loads[:, axis]
            offered = sign * found.loads[:, axis]
            assert set(offered[offered > 0.0]) == ({sizes.max()} if sizes.max() > 0.0 else set())


def test_loads_of_a_rig_are_rounded_to_those_of_usual_tests_or_two_digits() -> None:
    made = read_laxity("s192803").protocol
    is_exact, flexion, loads = nominal_trials(made)
    assert not is_exact.any()
    assert set(flexion) == {5.0, 36.0, 57.0, 87.0}
    assert {x: set(loads[:, i]) - {0.0} for i, x in enumerate(LOADS)} == {
        "internal_moment_Nm": {-7.6, 7.7},
        "varus_moment_Nm": {-10.0, 10.0},
        "anterior_force_N": {-200.0, 200.0},
        # The rig holds it in all trials.
        "distraction_force_N": {-50.0},
        "lateral_force_N": set(),
    }
    assert (np.count_nonzero(loads[:, [0, 1, 2, 4]], axis=1) == 1).sum() == 24
    found = candidate_trials(made, [0])
    assert not set(found.trials) & set(made.trials)


def test_what_was_made_exactly_is_a_repeat_beside_what_was_not() -> None:
    made = load_protocol("drawer")
    loads, names = np.array(made.loads), made.trials
    loads[2, 0] = 0.04
    found = candidate_trials(replace(made, loads=loads), [])
    assert set(names) - set(found.trials) == {names[2]}
    assert found.n == made.n


def test_a_small_load_held_beside_a_large_one_keeps_its_sign() -> None:
    """Less compression than the rig holds is still compression."""
    loads = np.zeros((6, 5))
    loads[:, 3] = [-50.0, -50.2, -49.9, -50.1, -10.0, -249.0]
    loads[1:3, 2] = [100.3, -99.6]
    made = Protocol(
        name="held",
        trials=tuple("abcdef"),
        flexion_deg=30.0 + 0.1 * np.arange(6, dtype=np.float64),
        loads=loads,
    )
    _, _, meant = nominal_trials(made)
    np.testing.assert_array_equal(meant[4:, 3], [-10.0, -250.0])
    assert not meant[3].any()
