"""Many searches from many starts: where each ended, why it ended there, and where it goes on to."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.fit import BUDGET, METHODS, Fit, fit
from identknee.calibrate.gauss_newton import gauss_newton
from identknee.calibrate.problem import Problem
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray, IntArray, frozen
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry
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
WORDS = tuple(x.value for x in OUTCOMES)
BY_START = ("start", "parameter")
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


@declared
class Searches:
    """The ends of N searches in p parameters, failed ones included.

    An *end* is what the optimizer gave back, whatever it is. Its *kind* says what is there:
    ``minimum`` if exact derivatives put the minimum within 0.01 typical steps (0.03 kN, 0.02 %),
    ``cliff`` if 0.01 typical steps down the way on the prediction is lost or has jumped,
    ``valley`` if the way down is open and the optimizer stopped all the same, ``start_failed`` if
    it saw no prediction at all. From the end least squares with exact derivatives goes on to the
    *polished* end.
    """

    method: str = entry("Optimizer")
    budget: int = entry("Simulations that a search may make", unit="1")
    seed: int = entry("Seed that the seed of each search follows from")
    parameters: Parameters = entry(
        "Parameters of the problem, their bounds and priors", group="parameters", is_in_json=False
    )
    starts: Array = array("Theta begun at", *BY_START, unit=OF_PARAMETER, key="theta_start")
    ends: Array = array(
        "Theta at the end; the start where nothing had a prediction",
        *BY_START,
        unit=OF_PARAMETER,
        key="theta",
    )
    polished: Array = array(
        "Theta of the polished end", *BY_START, unit=OF_PARAMETER, key="theta_polished"
    )
    objectives: Array = array(
        "Half the sum of squares at the end; infinite without a prediction",
        "start",
        key="objective",
    )
    polished_objectives: Array = array(
        "Half the sum of squares at the polished end", "start", key="objective_polished"
    )
    n_simulations: IntArray = array("Simulations of the search", "start", dtype=int)
    n_polishing: IntArray = array("Simulations of what follows it", "start", dtype=int)
    outcome_codes: IntArray = array(
        "How the search ended", "start", dtype=int, key="outcome", words=WORDS
    )
    kind_codes: IntArray = array("What is at its end", "start", dtype=int, key="kind", words=WORDS)
    polished_codes: IntArray = array(
        "How the polishing ended", "start", dtype=int, key="outcome_polished", words=WORDS
    )
    seconds: Array = array(
        "Time of each search and its polishing, which alone differs when they are repeated",
        "start",
        unit="s",
        group="timing",
    )

    @property
    @derived("Searches made", unit="1", key="n_starts")
    def n(self) -> int:
        """How many searches there are."""
        return len(self.starts)

    @property
    @derived("Simulations of all searches", unit="1", key="n_simulations")
    def total_simulations(self) -> int:
        """Simulations of all searches."""
        return int(self.n_simulations.sum())

    @property
    @derived("Simulations of polishing all ends", unit="1", key="n_polishing")
    def total_polishing(self) -> int:
        """Simulations of polishing all ends."""
        return int(self.n_polishing.sum())

    @property
    @derived("Ends of each kind, of those that occur")
    def kinds(self) -> dict[str, int]:
        """How many ends there are of each kind."""
        return self.counts(self.kind_codes)

    @property
    @derived("Searches by how they ended")
    def outcomes(self) -> dict[str, int]:
        """How many searches ended in each way."""
        return self.counts(self.outcome_codes)

    @property
    @derived("Polished ends by how the polishing ended")
    def polished_outcomes(self) -> dict[str, int]:
        """How many polishings ended in each way."""
        return self.counts(self.polished_codes)

    @property
    @derived("Half the sum of squares at the lowest polished end", unit="1", key="objective")
    def lowest_objective(self) -> float:
        """The lowest of all polished objectives; infinite where nothing had a prediction."""
        return float(self.polished_objectives[self.best])

    @property
    @derived("Mean time by tenth of the starts, in their order, and deciles of the time", unit="s")
    def seconds_per_start(self) -> dict[str, list[float]]:
        """Whether a start costs the same when there are more."""
        return {
            "by_tenth_of_starts": [float(x.mean()) for x in tenths(self.seconds)],
            "deciles": np.quantile(self.seconds, np.linspace(0.0, 1.0, 11)).tolist(),
        }

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
        kinds = ", ".join(f"{k} {x}" for x, k in self.kinds.items())
        polished = ", ".join(f"{k} {x}" for x, k in self.polished_outcomes.items())
        return f"{self.n} searches by {self.method}: {kinds}; polished: {polished}"


def tenths(values: Array) -> list[Array]:
    """`values` in ten parts in their order, fewer where there are fewer values.

    Examples
    --------
    >>> [x.tolist() for x in tenths(np.arange(3.0))]
    [[0.0], [1.0], [2.0]]
    """
    return [part for part in np.array_split(values, 10) if part.size]


def sweep(
    problem: Problem,
    starts: ArrayLike,
    *,
    method: str = "least-squares",
    budget: int | None = None,
    seed: int = 0,
    executor: Executor = serial,
    store: Store | None = None,
) -> Searches:
    """The end of a search from each start, what it is, and the end polished by least squares.

    Parameters
    ----------
    problem
        What to fit; picklable if `executor` runs processes.
    starts
        Where to begin, shape ``(N, p)``, such as from
        `identknee.identify.sweep.starts_design.sobol_starts`.
    method, budget
        Method and budget of each search, as for `identknee.fit`.
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
    return _searches(problem.parameters, points, rows, method=method, budget=allowed, seed=seed)


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
    if ahead.length <= AT_MINIMUM or ahead.is_on_a_kink:
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


def _searches(
    parameters: Parameters, starts: Array, rows: Array, *, method: str, budget: int, seed: int
) -> Searches:
    p = parameters.n
    numbers = rows[:, 2 * p :]
    return Searches(
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
