"""Verbs give the same bits on a dask cluster of two, one worker of which was lost, as alone.

They run in a fresh process, as in `test_executors_agree`.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest
from cli_runs import said
from few_starts import use_few_starts
from held import both_of
from small_knee import small_knee, small_protocol

import identknee as ik
from identknee.model.effects.loads import compression
from identknee.model.effects.readings import tibia_frame
from identknee.runs.executors import dask_cluster
from identknee.verbs.answer import Answer

# Two parameters stay free.
HELD = both_of("back", "outer", "inner")
CANDIDATES = """
format = 1
name = "small"
[[ramps]]
flexion_deg = [0, 8]
load = "internal_moment_Nm"
values = [0.2, 0.4]
"""
ON_DATA: Mapping[str, Mapping[str, Any]] = {
    "fit": {"budget": 3},
    "profile": {"budget": 60},
    "information": {},
    "sample": {"moves": "difference", "budget": 300},
    "sweep": {"n_starts": 6, "paths": 2},
    "design": {"n_trials": 1},
    "equivalents": {"n_sets": 2, "forces": "none"},
    "sensitivity": {"method": "morris", "samples": 2},
}
ON_PROTOCOL: Mapping[str, tuple[Callable[..., Answer], Mapping[str, Any]]] = {
    "simulate": (ik.simulate, {}),
    "check": (ik.verbs.check_subject, {"samples": 4}),
    "settle": (ik.verbs.settle_subject, {"within": 1.0}),
}


@cache
def found() -> dict[str, Any]:
    """What each verb says alone and on the cluster."""
    tests = Path(__file__).parents[1]
    path = os.pathsep.join(str(x) for x in (tests.parent, tests, tests / "support"))
    done = subprocess.run(
        [sys.executable, __file__],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["diagnose", *ON_DATA, *ON_PROTOCOL])
def test_a_verb_gives_the_same_bits_on_a_cluster(verb: str) -> None:
    pytest.importorskip("distributed")
    alone, together = found()[verb]
    assert together == alone


@pytest.mark.slow
def test_the_tasks_of_a_lost_worker_go_to_another() -> None:
    pytest.importorskip("distributed")
    assert found()["lost"] == [[0, 1, 4, 9], True]


def _square(flag: Path, x: int) -> int:
    """The square; the first worker that is asked dies of it."""
    try:
        flag.touch(exist_ok=False)
    except FileExistsError:
        return x**2
    os._exit(1)


def _calls(folder: Path) -> dict[str, Callable[..., Answer]]:
    knee, protocol = small_knee(), small_protocol()
    laxity = ik.simulate(knee, protocol, noise="0.1mm,0.1deg", seed=1).noisy
    assert laxity is not None
    candidates = folder / "candidates.toml"
    candidates.write_text(CANDIDATES, encoding="utf-8")
    given: dict[str, Callable[..., Answer]] = {
        x: partial(getattr(ik, x), knee, laxity, fixed=HELD, **y) for x, y in ON_DATA.items()
    }
    given["design"] = partial(given["design"], candidates=candidates)
    # Rotations read too large, so that causes are refitted.
    bent = replace(laxity, coordinates=laxity.coordinates * [1.0, 1.0, 1.0, 1.0, 1.5])
    causes = [tibia_frame(), compression()]
    given["diagnose"] = partial(ik.diagnose, knee, bent, effects=causes)
    return given | {
        x: partial(f, knee, protocol=protocol, **y) for x, (f, y) in ON_PROTOCOL.items()
    }


def _main() -> None:
    from distributed import LocalCluster

    told: dict[str, Any] = {}
    with (
        pytest.MonkeyPatch.context() as patch,
        tempfile.TemporaryDirectory() as folder,
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
    ):
        use_few_starts(patch)
        address, flag = cluster.scheduler_address, Path(folder) / "died"
        with dask_cluster(address) as executor:
            squares = list(executor.map(partial(_square, flag), range(4)))
        told["lost"] = [squares, flag.exists()]
        for verb, call in _calls(Path(folder)).items():
            told[verb] = [said(call(workers=x)) for x in (1, address)]
    print(json.dumps(told))


if __name__ == "__main__":
    _main()
