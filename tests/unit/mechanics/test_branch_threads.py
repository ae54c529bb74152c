"""Branches of load paths in several threads: the same bits, every node once, no thread left."""

import ctypes
import threading
import time
from collections.abc import Callable
from contextvars import copy_context

import numpy as np
import pytest

from identknee.mechanics.branch_threads import Helper, branch_threads, pieces_of
from identknee.mechanics.memory import ALONE, ASLEEP, N_EVALUATIONS
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.runs.arrays import IntArray


@pytest.fixture(autouse=True)
def eight_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 8)


def assert_same_bits(found: Prediction, expected: Prediction) -> None:
    for name in ("coordinates", "jacobian", "node_poses", "centres"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("n", [2, 3, 8])
def test_threads_change_no_bit(reference_model: LaxityModel, n: int) -> None:
    """One simulation after the other, and after pauses in which helpers go to sleep."""
    generator = np.random.default_rng(n)
    thetas = reference_model.parameters.start * generator.uniform(0.98, 1.02, size=(40, 8))
    alone = [reference_model.predict(x) for x in thetas]
    with branch_threads(n):
        for i, theta in enumerate(thetas):
            assert_same_bits(reference_model.predict(theta), alone[i])
            time.sleep(0.05 * (i % 10 == 9))


def test_helpers_take_a_share(
    reference_model: LaxityModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a helper evaluated is counted in its own memory."""
    made: list[Helper] = []

    class Remembered(Helper):
        def __init__(self) -> None:
            super().__init__()
            made.append(self)

    monkeypatch.setattr("identknee.mechanics.branch_threads.Helper", Remembered)
    evaluations = 0
    with branch_threads(2):
        # Other processes may keep a helper away from some.
        for _ in range(200):
            reference_model.predict(reference_model.parameters.start)
            packed = made[0].kept.packed
            assert packed is not None
            evaluations += int(packed.arrays.evaluation.counts[N_EVALUATIONS])
    assert evaluations > 0


def test_other_sizes_change_no_bit(reference_model: LaxityModel, stable_model: LaxityModel) -> None:
    """Two knees turn by turn."""
    models = (reference_model, stable_model)
    alone = [x.predict(x.parameters.start) for x in models]
    with branch_threads(2):
        for i in np.random.default_rng(0).integers(2, size=60):
            assert_same_bits(models[i].predict(models[i].parameters.start), alone[i])


class Code:
    """What stands for compiled code: it is inside until it is told to leave."""

    def __init__(self) -> None:
        self.is_entered, self.may_leave = threading.Event(), threading.Event()
        self._loaded = self.run

    def prepared(self, *arguments: int) -> tuple[Callable[[int], None], list[int]]:
        return self._loaded, [ALONE, 0, *arguments]

    def run(self, _table: int) -> None:
        self.is_entered.set()
        assert self.may_leave.wait(10.0)


def test_a_helper_inside_other_code_is_offered_nothing_and_told_to_leave() -> None:
    one, other = Code(), Code()
    helper = Helper()
    table = np.ctypeslib.as_array((ctypes.c_int64 * 3).from_address(helper.address))
    assert helper.prepare(one, 5)  # type: ignore[arg-type]
    assert one.is_entered.wait(10.0)
    assert helper.prepare(one, 6)  # type: ignore[arg-type]
    assert table.tolist() == [ASLEEP, 0, 6]
    assert not helper.prepare(other, 7)  # type: ignore[arg-type]
    assert table.tolist() == [ASLEEP, 1, 6]
    one.may_leave.set()
    began = time.monotonic()
    while not helper.prepare(other, 7):  # type: ignore[arg-type]
        assert time.monotonic() - began < 10.0
    assert table.tolist() == [ASLEEP, 0, 7]
    assert other.is_entered.wait(10.0)
    other.may_leave.set()
    helper.dismiss()


def test_two_threads_of_one_context_do_not_share_helpers_at_once(
    reference_model: LaxityModel,
) -> None:
    theta = reference_model.parameters.start
    alone = reference_model.predict(theta)
    found: list[Prediction] = []

    def predict() -> None:
        found.extend(reference_model.predict(theta) for _ in range(30))

    with branch_threads(2):
        both = [threading.Thread(target=copy_context().run, args=(predict,)) for _ in range(2)]
        for each in both:
            each.start()
        for each in both:
            each.join()
    assert len(found) == 60
    for each_found in found:
        assert_same_bits(each_found, alone)


def test_no_thread_is_left(reference_model: LaxityModel) -> None:
    before = threading.active_count()
    with branch_threads(3):
        reference_model.predict(reference_model.parameters.start)
        assert threading.active_count() == before + 2
    assert threading.active_count() == before


def test_there_are_no_more_threads_than_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    before = threading.active_count()
    with branch_threads(4):
        assert threading.active_count() == before


def tree(*parent: int) -> IntArray:
    return np.array(parent)


def test_branches_begin_at_the_root_or_wait_for_the_trunk() -> None:
    # 0 and 3 are the trunk: of 0 hang 1-2 and 3, of 3 hang 4-5 and 6-7.
    pieces = pieces_of(tree(-1, 0, 1, 0, 3, 4, 3, 6).tobytes(), 2)
    assert pieces.nodes.tolist() == [0, 3, 1, 2, 6, 7, 4, 5]
    assert pieces.ends.tolist() == [1, 2, 4, 6, 8]
    assert pieces.n_early.tolist() == [1]


@pytest.mark.parametrize("n", [2, 3, 8])
def test_every_node_is_in_one_piece_and_after_its_parent(
    reference_model: LaxityModel, n: int
) -> None:
    parent = reference_model.paths.parent
    for before in (parent, tree(*[-1] * 10), tree(-1), tree(-1, 0, 1, 2)):
        pieces = pieces_of(before.tobytes(), n)
        assert sorted(pieces.nodes.tolist()) == list(range(len(before)))
        assert pieces.ends[-1] == len(before)
        place = np.argsort(pieces.nodes)
        has_parent = before >= 0
        # Whatever order branches are taken in.
        piece = np.searchsorted(pieces.ends, place, side="right")
        early = 2 + pieces.n_early[0]
        for node in np.flatnonzero(has_parent):
            here, there = piece[node], piece[before[node]]
            assert here == there or there == 0 or (there == 1 and here >= early)
        assert np.all(place[before[has_parent]] < place[has_parent])


def test_no_threads_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 1, got 0"), branch_threads(0):
        pass
