"""Linear algebra keeps to one thread while a verb computes, here and in its workers."""

import os

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import identknee as ik
from identknee.runs.executors import LIBRARY_THREADS, one_library_thread, process_pool


def blas_threads(_: int = 0) -> int:
    """The most threads that linear algebra may use in this process."""
    np.linalg.svd(np.eye(3))
    return max(int(x["num_threads"]) for x in threadpool_info() if x["user_api"] == "blas")


def test_threads_are_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIBRARY_THREADS[0], "2")
    monkeypatch.delenv(LIBRARY_THREADS[1], raising=False)
    with threadpool_limits(limits=2, user_api="blas"):
        with one_library_thread():
            assert blas_threads() == 1
            assert {os.environ[name] for name in LIBRARY_THREADS} == {"1"}
        assert blas_threads() == 2
    assert os.environ[LIBRARY_THREADS[0]] == "2"
    assert LIBRARY_THREADS[1] not in os.environ


def test_a_verb_computes_with_one(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    monkeypatch.setattr("identknee.verbs.simulate.warm_up", lambda *_: seen.append(blas_threads()))
    with threadpool_limits(limits=2, user_api="blas"):
        ik.simulate("reference", "drawer")
    assert seen == [1]


def test_a_worker_computes_with_one(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in LIBRARY_THREADS:
        monkeypatch.setenv(name, "2")
    with process_pool(2) as executor:
        assert list(executor.map(blas_threads, [0, 1])) == [1, 1]
