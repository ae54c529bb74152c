"""A sweep keeps every end, says what it is, and repeats itself bit for bit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from landscapes import Quadrant, TwoWells
from problems import (
    ClosedForm,
    Linear,
    plain_parameters,
    rosenbrock,
    sloppy_springs,
    wall_before_the_minimum,
)

from identknee.calibrate.fit import METHODS, fit
from identknee.calibrate.problem import Problem
from identknee.identify import sweep as module
from identknee.identify.sweep import (
    SweepSearches,
    classify_end,
    search_seed,
    shell_starts,
    sobol_starts,
    sweep,
)
from identknee.runs.executors import process_pool
from identknee.runs.record import Outcome
from identknee.runs.store import open_work

LEAST_SQUARES = 1e-5
REPEATED = tuple(
    x for x in SweepSearches.__dataclass_fields__ if x not in {"seconds", "parameters"}
)


def assert_equal(first: SweepSearches, second: SweepSearches) -> None:
    for name in REPEATED:
        assert np.array_equal(getattr(first, name), getattr(second, name)), name


def test_ends_of_least_squares_are_its_fits() -> None:
    problem = TwoWells()
    starts = sobol_starts(problem.parameters, 30, seed=1)
    found = sweep(problem, starts, seed=7)
    for i in (0, 13, 29):
        alone = fit(problem, starts[i], seed=search_seed(7, i))
        assert np.array_equal(found.ends[i], alone.theta)
        assert found.objectives[i] == alone.objective
        assert found.n_simulations[i] == alone.n_simulations
    assert found.counts(found.kind_codes) == {"minimum": 30}
    assert np.array_equal(found.polished, found.ends)
    assert not found.n_polishing.any()


@pytest.mark.parametrize("method", METHODS)
def test_every_optimizer_is_polished_to_a_minimum(method: str) -> None:
    spring = sloppy_springs()
    starts = shell_starts(spring.parameters, 2, center=spring.minimum, distances=[1.0], seed=3)
    found = sweep(spring, starts, method=method, budget=300)
    assert np.all(found.is_polished)
    # Annealing jumps from the second start to where another minimum is the nearest.
    assert np.allclose(found.polished[0], spring.minimum, atol=LEAST_SQUARES)
    assert np.all(found.polished_objectives <= found.objectives)
    wanted = Outcome.MINIMUM if method == "least-squares" else Outcome.VALLEY
    assert np.all(found.is_kind(wanted))


def test_an_end_next_to_the_minimum_is_called_that_minimum() -> None:
    problem = rosenbrock()
    far, near = (
        fit(problem, problem.minimum, method="complex", budget=n, seed=1) for n in (40, 2500)
    )
    assert classify_end(problem, far) is Outcome.VALLEY
    assert classify_end(problem, near) is Outcome.MINIMUM
    assert near.outcome is Outcome.SPREAD


def test_a_wall_in_the_way_is_a_cliff() -> None:
    wall = wall_before_the_minimum()
    found = sweep(wall, wall.problem.start[None])
    assert found.is_kind(Outcome.CLIFF).all()
    assert not found.is_polished.any()
    assert np.allclose(found.polished, found.ends, atol=0.01)
    assert np.all(found.polished_objectives <= found.objectives)
    ended = fit(wall, wall.problem.start, method="cma-es", seed=1)
    assert classify_end(wall, ended) is Outcome.CLIFF


def test_a_jump_in_the_way_is_a_cliff() -> None:
    def residuals(x: Any) -> Any:
        return np.array([x[0] + (5.0 if x[0] < 1.0 else 0.0), x[1]])

    jump = ClosedForm(
        name="jump",
        parameters=plain_parameters(2),
        start=np.array([3.0, 1.0]),
        minimum=np.array([1.0, 0.0]),
        lowest=0.5,
        residuals_at=residuals,
        jacobian_at=lambda _: np.eye(2),
    )
    ended = fit(jump, jump.start, method="cma-es", seed=2)
    assert ended.theta == pytest.approx(jump.minimum, abs=1e-2)
    assert classify_end(jump, ended) is Outcome.CLIFF


def test_starts_without_a_prediction_are_kept() -> None:
    problem = Quadrant()
    starts = np.array([[1.0, 1.0], [5.0, 1.0], [-3.0, 2.0]])
    found = sweep(problem, starts)
    assert found.is_kind(Outcome.START_FAILED).tolist() == [False, True, False]
    assert np.array_equal(found.ends[1], starts[1])
    assert np.isinf(found.objectives[1])
    assert np.isinf(found.polished_objectives[1])
    assert found.best != 1
    assert str(found).startswith("3 searches")
    assert str(found).count("2 minimum, 1 start_failed") == 2


def test_a_search_depends_on_its_number_alone() -> None:
    problem = TwoWells()
    starts = sobol_starts(problem.parameters, 6, seed=1)
    all_of_them = sweep(problem, starts, method="complex", budget=60, seed=5)
    some = sweep(problem, starts[:4], method="complex", budget=60, seed=5)
    assert np.array_equal(some.ends, all_of_them.ends[:4])
    other = sweep(problem, starts[:4], method="complex", budget=60, seed=6)
    assert not np.array_equal(other.ends, some.ends)


@pytest.mark.parametrize(
    ("method", "budget"),
    [("least-squares", None), pytest.param("complex", 60, marks=pytest.mark.slow)],
)
def test_workers_and_chunks_change_nothing(
    method: str, budget: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem: Problem = TwoWells()
    starts = sobol_starts(problem.parameters, 50, seed=2)
    whole = sweep(problem, starts, method=method, budget=budget)
    monkeypatch.setattr(module, "CHUNK", 20)
    monkeypatch.setattr(module, "STARTS_A_TASK", {"least-squares": 3})
    with process_pool(2) as executor:
        assert_equal(sweep(problem, starts, method=method, budget=budget, executor=executor), whole)


def test_a_sweep_resumes_to_the_same_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    starts = sobol_starts(plain_parameters(2, -6.0, 6.0), 12, seed=3)
    whole = sweep(TwoWells(), starts, method="complex", budget=50)
    real, calls = module._end, []

    def dies_at_the_sixth(*arguments: Any) -> list[float]:
        calls.append(arguments[-2])
        if len(calls) == 6:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(module, "_end", dies_at_the_sixth)
    with (
        open_work(tmp_path / "work.sqlite", {"of": "a test"}) as store,
        pytest.raises(KeyboardInterrupt),
    ):
        sweep(TwoWells(), starts, method="complex", budget=50, store=store)
    with open_work(tmp_path / "work.sqlite", {"of": "a test"}) as store:
        resumed = sweep(TwoWells(), starts, method="complex", budget=50, store=store)
    assert_equal(resumed, whole)
    assert calls == [0, 1, 2, 3, 4, 5, *range(5, 12)]


def test_arrays_of_a_sweep_cannot_be_changed() -> None:
    problem = Linear(parameters=plain_parameters(1), matrix=np.eye(1), data=np.zeros(1))
    found = sweep(problem, np.array([[1.0]]))
    for name in ("starts", "ends", "kind_codes"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(found, name)[0] = 0


@pytest.mark.parametrize(
    ("starts", "settings", "why"),
    [
        (np.zeros((0, 2)), {}, "at least one"),
        (np.array([[0.0, 0.0], [np.nan, 1.0]]), {}, "start 1 is"),
        (np.zeros((1, 3)), {}, "shape any x 2"),
        (np.zeros((1, 2)), {"method": "best"}, "no method 'best'"),
        (np.zeros((1, 2)), {"budget": 0}, "at least 1 simulation"),
    ],
)
def test_mistakes_are_named(starts: Any, settings: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        sweep(TwoWells(), starts, **settings)
