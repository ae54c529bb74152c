"""Needs the extra `cluster`; a cluster takes seconds to start, so the tests share one."""

import json
import math
import os
import signal
import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from identknee.runs.executors import Executor, WorkerTerminated, dask_cluster, spawn_seeds
from identknee.runs.store import resumable_map

WHY = "the extra `cluster` is not installed"
dask = pytest.importorskip("dask", reason=WHY)
pytest.importorskip("distributed", reason=WHY)


def draw(power: float, seed: np.random.SeedSequence) -> dict[str, Any]:
    values = np.exp(np.random.default_rng(seed).standard_normal(50)) ** power
    return {"values": values, "sum": values.sum(), "last": math.inf}


def refuse(item: int) -> int:
    raise ValueError(f"item {item} is refused")


def die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Executor]:
    with dask_cluster(2) as executor:
        yield executor


def test_two_workers_give_the_bits_of_none(cluster: Executor) -> None:
    seeds = spawn_seeds(3, 12)
    function = partial(draw, 1.7)
    expected = json.dumps(resumable_map(function, seeds))
    assert json.dumps(resumable_map(function, seeds, executor=cluster)) == expected


def test_a_running_scheduler_is_found_by_its_address(cluster: Any) -> None:
    address = cluster._client.scheduler.address
    with dask_cluster(address) as executor:
        assert list(executor.map(math.sqrt, [4.0, 9.0])) == [2.0, 3.0]


def test_an_error_comes_back_as_it_was(cluster: Executor) -> None:
    with pytest.raises(ValueError, match="item 1"):
        resumable_map(refuse, [1, 2], executor=cluster)
    assert resumable_map(math.sqrt, [4.0], executor=cluster) == [2.0]


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX systems")
def test_a_dead_worker_is_a_sentence() -> None:
    with (
        dask_cluster(1) as executor,
        pytest.raises(WorkerTerminated, match=r"dask.*died"),
    ):
        resumable_map(die, [1], executor=executor)


def test_an_address_without_a_scheduler_is_said() -> None:
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "0.2s"}),
        pytest.raises(ValueError, match=r"scheduler.*tcp://127\.0\.0\.1:9"),
        dask_cluster("tcp://127.0.0.1:9"),
    ):
        pass


def test_without_dask_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ModuleNotFoundError, match=r"identknee\[cluster\]"),
        dask_cluster(2),
    ):
        pass
