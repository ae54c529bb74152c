"""Fits of a knee are the same bits whoever makes them: this process, others, or a cluster.

They are made in a fresh process, as users make them.
"""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from small_knee import small_knee, small_protocol

from identknee.calibrate.fit import fit_many
from identknee.laxity.table import add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import Array
from identknee.runs.executors import Executor, process_pool, serial, threads

HAS_DASK = importlib.util.find_spec("distributed") is not None


def test_every_executor_gives_the_same_fits_of_a_knee() -> None:
    tests = Path(__file__).parents[1]
    path = os.pathsep.join(str(x) for x in (tests.parent, tests / "support"))
    done = subprocess.run(
        [sys.executable, __file__],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == {"serial", "processes", "threads"} | ({"dask"} if HAS_DASK else set())
    for name, fits in found.items():
        assert fits == found["serial"], name
    assert len({tuple(fit["theta"]) for fit in found["serial"]}) == len(found["serial"])


def _problem() -> tuple[LaxityResiduals, Array]:
    """Noisy laxity of the small knee, and four starts."""
    model = LaxityModel(knee=small_knee(), protocol=small_protocol())
    center, rng = model.parameters.center, np.random.default_rng(0)
    laxity = add_noise(model.simulate(center), sd_mm=0.1, sd_deg=0.1, seed=0)
    starts = center + rng.uniform(-0.2, 0.2, (4, center.size)) * np.abs(center)
    return LaxityResiduals(model=model, laxity=laxity), starts


def _fits(problem: LaxityResiduals, starts: Array, executor: Executor) -> list[dict[str, Any]]:
    return [
        {
            "theta": fit.theta.tolist(),
            "objective": fit.objective,
            "history": fit.history.tolist(),
            "gradient_norm": fit.gradient_norm,
            "outcome": fit.outcome.value,
        }
        for fit in fit_many(problem, starts, budget=40, priors=True, executor=executor)
    ]


def _main() -> None:
    problem, starts = _problem()
    found = {"serial": _fits(problem, starts, serial)}
    with process_pool(2) as executor:
        found["processes"] = _fits(problem, starts, executor)
    with threads(2) as executor:
        found["threads"] = _fits(problem, starts, executor)
    if HAS_DASK:
        from identknee.runs.executors import dask_cluster

        with dask_cluster(2) as executor:
            found["dask"] = _fits(problem, starts, executor)
    print(json.dumps(found))


if __name__ == "__main__":
    _main()
