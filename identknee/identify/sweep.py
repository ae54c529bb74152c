"""Multi-start searches: where each ended, why, and where polishing leads."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike
from typing_extensions import override

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.fit import BUDGET, METHODS, Fit, fit
from identknee.calibrate.least_squares import gauss_newton
from identknee.calibrate.problem import STIFFNESS_UNIT, STRAIN_UNIT, Problem, typical_steps
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray, IntArray, frozen
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.record import Outcome
from identknee.runs.store import Store, resumable_map

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
class SweepSearches:
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
            "by_tenth_of_starts": [float(x.mean()) for x in split_into_tenths(self.seconds)],
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

    @override
    def __str__(self) -> str:
        """What is at the ends, and where they go on to."""
        kinds = ", ".join(f"{k} {x}" for x, k in self.kinds.items())
        polished = ", ".join(f"{k} {x}" for x, k in self.polished_outcomes.items())
        return f"{self.n} searches by {self.method}: {kinds}; polished: {polished}"


def split_into_tenths(values: Array) -> list[Array]:
    """`values` split into up to ten consecutive parts.

    Examples
    --------
    >>> [x.tolist() for x in split_into_tenths(np.arange(3.0))]
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
) -> SweepSearches:
    """The end of a search from each start, what it is, and the end polished by least squares.

    Parameters
    ----------
    problem
        What to fit; picklable if `executor` runs processes.
    starts
        Where to begin, shape ``(N, p)``, such as from
        `identknee.identify.sweep.sobol_starts`.
    method, budget
        Method and budget of each search, as for `identknee.fit`.
    seed
        The seed of search i follows from it and from i alone, so that neither the number of starts
        nor that of workers changes a search.
    executor
        Anything with an ordered ``map``.
    store
        Where finished searches are kept, from `identknee.runs.store.open_work`, told of the
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


def classify_end(problem: Problem, end: Fit) -> Outcome:
    """The kind of end of a search: a minimum, a valley, a cliff or a failure."""
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
    kind = classify_end(problem, end)
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
) -> SweepSearches:
    p = parameters.n
    numbers = rows[:, 2 * p :]
    return SweepSearches(
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


# Unit of `distance`.
DISTANCE = "kN and %"
# Draws of one start before it is said that the bounds leave no room at its distance.
MAX_DRAWS = 10_000


def sobol_starts(parameters: Parameters, n: int, *, seed: int = 0) -> Array:
    """Points that fill the bounds evenly, shape ``(n, p)``; the first ones stay when `n` grows.

    They are a Sobol sequence with Owen's scrambling.

    Raises
    ------
    ValueError
        If `n` is less than 1 or a bound is infinite.

    References
    ----------
    .. [1] Owen (1998), Journal of Complexity 14(4), 466-489.
           https://doi.org/10.1006/jcom.1998.0487
    """
    _check_number(n)
    for name, low, high in zip(parameters.names, parameters.lower, parameters.upper, strict=True):
        if not np.isfinite(high - low):
            raise ValueError(
                f"the bounds of {name} are {low:g} and {high:g}; "
                "give finite ones to spread starts between them"
            )
    sequence = scipy.stats.qmc.Sobol(parameters.n, seed=seed)
    unit = sequence.random_base2(int(n - 1).bit_length())[:n]
    return np.asarray(parameters.lower + (parameters.upper - parameters.lower) * unit)


def shell_starts(
    parameters: Parameters, n: int, *, center: ArrayLike, distances: ArrayLike, seed: int = 0
) -> Array:
    """Points at stated distances from one point, shape ``(n, p)``; start i has distance i mod k.

    On a shell at distance d the parameters of each unit differ by d on average: the stiffnesses by
    d kN and the reference strains by d %, as the paper counts the distance of its initial guesses.
    Within a unit the differences are uniform on that sphere of mean absolute values. Points outside
    the bounds are drawn again.

    Parameters
    ----------
    parameters
        For their units and bounds.
    n
        How many.
    center
        Truth or best fit, shape ``(p,)``.
    distances
        The distances of the shells, not negative, shape ``(k,)``.
    seed
        Start i is the same for the same seed whatever `n` is.

    Raises
    ------
    ValueError
        If `n` is less than 1, a distance is negative or missing, or the bounds leave no room.
    """
    _check_number(n)
    shells = np.asarray(distances, dtype=np.float64)
    if shells.ndim != 1 or shells.size == 0 or not np.all(shells >= 0):
        raise ValueError(f"distances of shells must be 0 or more, got {shells.tolist()}")
    middle = np.asarray(center, dtype=np.float64)
    groups = unit_groups(parameters)
    units = distance_units(parameters)
    starts = np.empty((n, parameters.n))
    for i in range(n):
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
        distance = float(shells[i % shells.size])
        for group in range(int(groups.max()) + 1):
            of_group = np.flatnonzero(groups == group)
            span = distance * units[of_group]
            starts[i, of_group] = _on_shell(of_group, middle, span, parameters, generator)
    return starts


def distance(thetas: ArrayLike, target: ArrayLike, parameters: Parameters) -> Array:
    """Distance of parameter sets from a given one, as in the paper, shape ``(...,)``.

    The mean absolute difference of the stiffnesses [kN] or of the reference strains [%], whichever
    is larger; parameters in other units count in typical steps, and nuisances do not count.

    Parameters
    ----------
    thetas
        Shape ``(..., p)``.
    target
        Shape ``(p,)``.
    parameters
        For their units.
    """
    groups = unit_groups(parameters)
    differences = np.abs(np.asarray(thetas) - np.asarray(target)) / distance_units(parameters)
    asked = [groups[parameters.is_of_interest] == k for k in range(int(groups.max()) + 1)]
    means = [
        differences[..., parameters.is_of_interest][..., one].mean(axis=-1)
        for one in asked
        if one.any()
    ]
    return np.asarray(np.max(means, axis=0))


def distance_units(parameters: Parameters) -> Array:
    """The unit of distance, shape ``(p,)``: 1 kN, 1 %, or a typical step."""
    is_known = [name.endswith((STIFFNESS_UNIT, STRAIN_UNIT)) for name in parameters.names]
    return np.where(is_known, 1.0, typical_steps(parameters))


def unit_groups(parameters: Parameters) -> IntArray:
    """The same number for parameters of the same kind, shape ``(p,)``: stiffness, strain, other."""
    kinds = [
        0 if name.endswith(STIFFNESS_UNIT) else 1 if name.endswith(STRAIN_UNIT) else 2
        for name in parameters.names
    ]
    return np.asarray(np.unique(kinds, return_inverse=True)[1], dtype=np.int64)


def _on_shell(
    of_group: IntArray,
    center: Array,
    span: Array,
    parameters: Parameters,
    generator: np.random.Generator,
) -> Array:
    """Values of a group's parameters on its shell, inside their bounds."""
    low, high = parameters.lower[of_group], parameters.upper[of_group]
    for _ in range(MAX_DRAWS):
        shares = generator.dirichlet(np.ones(of_group.size)) * of_group.size
        values = center[of_group] + generator.choice([-1.0, 1.0], of_group.size) * shares * span
        if np.all((values >= low) & (values <= high)):
            return np.asarray(values)
    names = ", ".join(parameters.names[i] for i in of_group)
    raise ValueError(
        f"the bounds of {names} leave no room for starts at a distance of "
        f"{float(span.max()):g}; widen the bounds or choose smaller distances"
    )


def _check_number(n: int) -> None:
    if n < 1:
        raise ValueError(f"the number of starts must be at least 1, got {n}")
