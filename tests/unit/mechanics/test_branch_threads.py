"""Branches of load paths in several threads: the same bits, every node once, no error lost."""

from functools import partial
from threading import Event, get_ident

import numpy as np
import pytest

from identknee.mechanics.branch_threads import branch_threads, on_branches, pieces_of
from identknee.model.laxity_model import LaxityModel
from identknee.runs.arrays import IntArray


@pytest.fixture(autouse=True)
def eight_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 8)


@pytest.mark.parametrize("n", [2, 3])
def test_threads_change_no_bit(reference_model: LaxityModel, n: int) -> None:
    theta = 1.01 * reference_model.parameters.start
    alone = reference_model.predict(theta)
    with branch_threads(n):
        shared = reference_model.predict(theta)
    for name in ("coordinates", "jacobian", "node_poses"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(alone, name))


def tree(*parent: int) -> IntArray:
    return np.array(parent)


def test_branches_begin_at_the_root_or_wait_for_the_trunk() -> None:
    # 0 and 3 are the trunk: of 0 hang 1-2 and 3, of 3 hang 4-5 and 6-7.
    pieces = pieces_of(tree(-1, 0, 1, 0, 3, 4, 3, 6).tobytes(), 2)
    assert pieces.root.tolist() == [0]
    assert pieces.trunk.tolist() == [3]
    assert [x.tolist() for x in pieces.early] == [[1, 2]]
    assert [x.tolist() for x in pieces.late] == [[4, 5], [6, 7]]


def _note(solved: list[int], nodes: IntArray) -> None:
    solved.extend(nodes.tolist())


@pytest.mark.parametrize("n", [2, 3, 8])
def test_every_node_is_solved_once_and_after_its_parent(
    reference_model: LaxityModel, n: int
) -> None:
    parent = reference_model.paths.parent
    for before in (parent, tree(*[-1] * 10), tree(-1), tree(-1, 0, 1, 2)):
        solved: list[int] = []
        with branch_threads(n):
            on_branches(before, partial(_note, solved))
        assert sorted(solved) == list(range(len(before)))
        place = np.argsort(solved)
        has_parent = before >= 0
        assert np.all(place[before[has_parent]] < place[has_parent])


@pytest.mark.parametrize("fails_in_own", [True, False])
def test_an_error_in_any_thread_is_raised_and_leaves_no_thread_waiting(
    fails_in_own: bool,
) -> None:
    own, is_helped = get_ident(), Event()

    def fail(nodes: IntArray) -> None:
        # The trunk is the own thread's; the branch 1-2 is left to the other one meanwhile.
        is_own = get_ident() == own
        if is_own and nodes[0] == 3:
            assert is_helped.wait(10.0)
        if not is_own:
            is_helped.set()
        if nodes[0] == (3 if fails_in_own else 1):
            raise RuntimeError("no pose")

    with branch_threads(2), pytest.raises(RuntimeError, match="no pose"):
        on_branches(tree(-1, 0, 1, 0, 3, 4, 3, 6), fail)


def test_there_are_no_more_threads_than_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    calls: list[list[int]] = []
    with branch_threads(4):
        on_branches(tree(-1, 0, 1), lambda nodes: calls.append(nodes.tolist()))
    assert calls == [[0, 1, 2]]


def test_no_threads_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 1, got 0"), branch_threads(0):
        pass
