import sys
from typing import Any

import numpy as np
import pytest
from problems import linear

from identknee.calibrate.fit import fit
from identknee.calibrate.population import CmaSearch, PymooSearch

pytest.importorskip("cma")
ga = pytest.importorskip("pymoo.algorithms.soo.nonconvex.ga")
pso = pytest.importorskip("pymoo.algorithms.soo.nonconvex.pso")

LIBRARIES = {
    "genetic": "pymoo.algorithms.soo.nonconvex.ga",
    "particle-swarm": "pymoo.algorithms.soo.nonconvex.pso",
    "cma-es": "cma",
}


@pytest.mark.parametrize("algorithm", [ga.GA, pso.PSO])
def test_first_population_is_the_papers_box_cut_to_the_bounds(algorithm: Any) -> None:
    parameters = linear().parameters
    start = np.array([8.0, 0.0, -9.0])
    first = PymooSearch(algorithm, parameters, start, np.random.default_rng(0)).ask()
    assert first.shape == (20, 3)
    assert np.all(np.abs(first - start) <= 3.0)
    assert np.all((first >= parameters.lower) & (first <= parameters.upper))
    assert np.all(np.ptp(first, axis=0) > 2.0)


def test_cma_starts_as_wide_as_the_box() -> None:
    parameters = linear().parameters
    rng = np.random.default_rng(0)
    candidates = np.concatenate([CmaSearch(parameters, np.zeros(3), rng).ask() for _ in range(300)])
    # A uniform number of half-width 3 has sd sqrt(3); five standard errors of an sd.
    bound = 5 * np.sqrt(3) / np.sqrt(2 * len(candidates))
    np.testing.assert_allclose(candidates.std(axis=0), np.sqrt(3), atol=bound)


@pytest.mark.parametrize("method", LIBRARIES)
def test_a_missing_package_says_what_to_install(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, LIBRARIES[method], None)
    problem = linear()
    with pytest.raises(ModuleNotFoundError, match=r"identknee\[optimizers\]"):
        fit(problem, problem.start, method=method)


def global_state() -> Any:
    state: Any = np.random.get_state()  # noqa: NPY002
    return state[1].copy()


@pytest.mark.parametrize("method", [*LIBRARIES, "annealing"])
def test_says_nothing_and_leaves_the_global_generator_alone(
    method: str, capfd: pytest.CaptureFixture[str]
) -> None:
    problem = linear()
    before = global_state()
    fit(problem, problem.start, method=method, budget=200)
    np.testing.assert_array_equal(before, global_state())
    assert capfd.readouterr() == ("", "")
