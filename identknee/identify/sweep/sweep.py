"""Many searches from many starts: where each ended, why it ended there, and where it goes on to."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.fit import BUDGET, METHODS, Fit, fit
from identknee.calibrate.gauss_newton import gauss_newton
from identknee.calibrate.problem import Problem
from identknee.calibrate.tolerances import KINK_SHARE
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray, IntArray, frozen, frozen_integers
from identknee.runs.executors import Executor, serial
from identknee.runs.outcome import Outcome
from identknee.runs.resume import resumable_map
from identknee.runs.store import Store

OUTCOMES = (
    Outcome.MINIMUM,
    Outcome.VALLEY,
    Outcome.CLIFF,
    Outcome.BUDGET,
    Outcome.SPREAD,
    Outcome.START_FAILED,
)
# In typical steps (3 kN, 2 %): an end closer to the minimum than this is called that minimum.
AT_MINIMUM = 0.01
# Times the change that the derivatives promise over such a step: a larger one is a jump.
JUMP = 10.0
# Starts that one task goes through: enough to outweigh its way to a worker.
STARTS_A_TASK = {"least-squares": 20}
# Starts that are under way or just done at a time; the rest are rows of arrays.
CHUNK = 10_000
# Beside the two ends: two objectives, two counts, three outcomes, one time.
N_NUMBERS = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sweep:
    """The ends of N searches in p parameters, failed ones included.

    An *end* is what the optimizer gave back, whatever it is. Its *kind* says what is there:
    ``minimum`` if exact derivatives put the minimum within 0.01 typical steps (0.03 kN, 0.02 %),
    ``cliff`` if 0.01 typical steps down the way on the prediction is lost or has jumped,
    ``valley`` if the way down is open and the optimizer stopped all the same, ``start_failed`` if
    it saw no prediction at all. From the end least squares with exact derivatives goes on to the
    *polished* end.

    Attributes
    ----------
    method, budget, seed
        The optimizer, the simulations it was allowed, and what the seed of each search follows
        from.
    parameters
        Those of the problem.
    starts, ends, polished
        Theta, shape ``(N, p)``; an end is its start where nothing had a prediction.
    objectives, polished_objectives
        Half the sum of squares there, shape ``(N,)``; inf without a prediction.
    n_simulations, n_polishing
        Simulations of the search, and of what follows it, shape ``(N,)``.
    outcome_codes, kind_codes, polished_codes
        How the search ended, what is at its end, how the polishing ended: places in `OUTCOMES`,
        shape ``(N,)``.
    seconds
        Time of each search and its polishing [s], shape ``(N,)``. Alone of all these it differs
        when the sweep is repeated.
    """

    method: str
    budget: int
    seed: int
    parameters: Parameters
    starts: Array
    ends: Array
    polished: Array
    objectives: Array
    polished_objectives: Array
    n_simulations: IntArray
    n_polishing: IntArray
    outcome_codes: IntArray
    kind_codes: IntArray
    polished_codes: IntArray
    seconds: Array

    def __post_init__(self) -> None:
        n, p = len(self.starts), self.parameters.n
        for name in ("starts", "ends", "polished"):
            object.__setattr__(self, name, frozen(getattr(self, name), n, p, name=name))
        for name in ("objectives", "polished_objectives", "seconds"):
            object.__setattr__(self, name, frozen(getattr(self, name), n, name=name))
        for name in _INTEGERS:
            object.__setattr__(self, name, frozen_integers(getattr(self, name)))

    @property
    def n(self) -> int:
        """How many searches there are."""
        return len(self.starts)

    @property
    def best(self) -> int:
        """Number of the search whose polished end is lowest."""
        return int(np.argmin(self.polished_objectives))

    @property
    def is_polished(self) -> BoolArray:
        """Whose polishing ended at a minimum, shape ``(N,)``."""
        return np.asarray(self.polished_codes == OUTCOMES.index(Outcome.MINIMUM))

    def is_kind(self, kind: Outcome) -> BoolArray:
        """Whose end is of this kind, shape ``(N,)``."""
        return np.asarray(self.kind_codes == OUTCOMES.index(kind))

    def counts(self, codes: IntArray) -> dict[str, int]:
        """How many there are of each outcome, by its word, of those that occur."""
        number = np.bincount(codes, minlength=len(OUTCOMES))
        return {x.value: int(k) for x, k in zip(OUTCOMES, number, strict=True) if k}

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """What is at the ends, and where they go on to."""
        kinds = ", ".join(f"{k} {x}" for x, k in self.counts(self.kind_codes).items())
        polished = ", ".join(f"{k} {x}" for x, k in self.counts(self.polished_codes).items())
        return f"{self.n} searches by {self.method}: {kinds}; polished: {polished}"


_INTEGERS = ("n_simulations", "n_polishing", "outcome_codes", "kind_codes", "polished_codes")


def sweep(
    problem: Problem,
    starts: ArrayLike,
    *,
    method: str = "least-squares",
    budget: int | None = None,
    seed: int = 0,
    executor: Executor = serial,
    store: Store | None = None,
) -> Sweep:
    """The end of a search from each start, what it is, and the end polished by least squares.

    Parameters
    ----------
    problem
        What to fit; picklable if `executor` runs processes.
    starts
        Where to begin, shape ``(N, p)``, such as from
        `identknee.identify.sweep.starts_design.sobol_starts`.
    method, budget
        Of each search, as for `identknee.fit`.
    seed
        The seed of search i follows from it and from i alone, so that neither the number of starts
        nor that of workers changes a search.
    executor
        Anything with an ordered ``map``.
    store
        Where finished searches are kept, from `identknee.runs.resume.open_work`, told of the
        problem and of all that the starts follow from.

    Raises
    ------
    ValueError
        If the starts have another length, are not finite or are none, or the method or the budget
        is not possible. Searches that fail are no error: they are kept.
    """
    points = frozen(starts, None, problem.parameters.n, name="starts")
    allowed = BUDGET if budget is None else budget
    _check(points, method, allowed)
    task = partial(_ends, problem, method, allowed, seed)
    size = STARTS_A_TASK.get(method, 1)
    rows = np.empty((len(points), 2 * problem.parameters.n + N_NUMBERS))
    for first in range(0, len(points), CHUNK):
        chunk = points[first : first + CHUNK]
        items = [(first + i, chunk[i : i + size].tolist()) for i in range(0, len(chunk), size)]
        blocks = resumable_map(
            task,
            items,
            executor=executor,
            store=store,
            name=f"{method}/{first}",
            description=f"sweeping by {method}",
        )
        rows[first : first + len(chunk)] = np.concatenate(blocks)
    return _sweep(problem.parameters, points, rows, method=method, budget=allowed, seed=seed)


def search_seed(seed: int, number: int) -> int:
    """Seed of search `number` of a sweep; `identknee.fit` with it repeats that search alone."""
    return int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])


def kind_of_end(problem: Problem, end: Fit) -> Outcome:
    """What is at the end of a search: a minimum, a valley, a cliff, or nothing at all."""
    if end.outcome is Outcome.START_FAILED:
        return Outcome.START_FAILED
    if end.method == "least-squares" and end.outcome in {Outcome.MINIMUM, Outcome.CLIFF}:
        return end.outcome
    here = evaluate(problem, end.theta)
    if not here.is_finite:
        return Outcome.VALLEY
    ahead = gauss_newton(here, problem.parameters)
    if ahead.length <= AT_MINIMUM or ahead.reduction <= KINK_SHARE * here.deviance:
        return Outcome.MINIMUM
    step = ahead.step * AT_MINIMUM / ahead.length
    expected = here.jacobian @ step
    unexpected = problem.residuals(end.theta + step) - here.residuals - expected
    # Infinite without a prediction, finite where a trial went over to another equilibrium.
    is_cut = not np.linalg.norm(unexpected) < JUMP * np.linalg.norm(expected)
    return Outcome.CLIFF if is_cut else Outcome.VALLEY


def _ends(
    problem: Problem, method: str, budget: int, seed: int, item: tuple[int, Sequence[Any]]
) -> list[list[float]]:
    first, starts = item
    search: Callable[[int, Any], list[float]] = partial(_end, problem, method, budget, seed)
    return [search(first + i, start) for i, start in enumerate(starts)]


def _end(
    problem: Problem, method: str, budget: int, seed: int, number: int, start: Any
) -> list[float]:
    """A row: end, polished end, objectives, counts, places in `OUTCOMES`, seconds."""
    began = time.perf_counter()
    own = search_seed(seed, number)
    end = fit(problem, start, method=method, seed=own, budget=budget)
    kind = kind_of_end(problem, end)
    polished, last, n_polishing = end, end.outcome, 0
    if end.outcome not in {Outcome.MINIMUM, Outcome.START_FAILED}:
        # Another seed, or a second look for a way around a cliff would be the first one again.
        further = fit(problem, end.theta, seed=own + 1)
        polished = further if further.objective < end.objective else end
        # An end on a bound is moved inside, which may be beyond the cliff it stands on.
        last = kind if further.outcome is Outcome.START_FAILED else further.outcome
        n_polishing = further.n_simulations
    return [
        *end.theta,
        *polished.theta,
        end.objective,
        polished.objective,
        end.n_simulations,
        n_polishing,
        *(OUTCOMES.index(x) for x in (end.outcome, kind, last)),
        time.perf_counter() - began,
    ]


def _sweep(
    parameters: Parameters, starts: Array, rows: Array, *, method: str, budget: int, seed: int
) -> Sweep:
    p = parameters.n
    numbers = rows[:, 2 * p :]
    return Sweep(
        method=method,
        budget=budget,
        seed=seed,
        parameters=parameters,
        starts=starts,
        ends=rows[:, :p],
        polished=rows[:, p : 2 * p],
        objectives=numbers[:, 0],
        polished_objectives=numbers[:, 1],
        n_simulations=numbers[:, 2].astype(np.int64),
        n_polishing=numbers[:, 3].astype(np.int64),
        outcome_codes=numbers[:, 4].astype(np.int64),
        kind_codes=numbers[:, 5].astype(np.int64),
        polished_codes=numbers[:, 6].astype(np.int64),
        seconds=numbers[:, 7],
    )


def _check(points: Array, method: str, budget: int) -> None:
    if len(points) == 0:
        raise ValueError("there is no start; give at least one")
    if not np.all(np.isfinite(points)):
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise ValueError(f"starts must be finite numbers, start {row} is {points[row].tolist()}")
    if method not in METHODS:
        raise ValueError(f"there is no method {method!r}; the methods are {', '.join(METHODS)}")
    if budget < 1:
        raise ValueError(f"the budget must be at least 1 simulation, got {budget}")
