"""Multi-start searches: where each ended and why, the basins they found, and how often."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike
from typing_extensions import override

from identknee.calibrate.fit import BUDGET, METHODS, Fit, fit
from identknee.calibrate.least_squares import gauss_newton
from identknee.calibrate.problem import (
    STIFFNESS_UNIT,
    STRAIN_UNIT,
    Problem,
    evaluate,
    sum_of_squares,
    typical_steps,
)
from identknee.identify.binomial_interval import Proportion, share
from identknee.model.parameters import Parameters
from identknee.runs.declare import (
    OF_PARAMETER,
    Array,
    BoolArray,
    IntArray,
    array,
    declared,
    derived,
    entry,
    frozen,
)
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
# In typical steps (3 kN, 2 %): an end closer to the minimum than this counts as the minimum.
AT_MINIMUM = 0.01
# A deviation from the linear change over such a step is a jump if it is so many times as large.
JUMP = 10.0
# Starts of one task: enough to outweigh the cost of sending it to a worker.
STARTS_A_TASK = {"least-squares": 20}
# Starts that are lists of Python objects at a time, to bound memory; all others are arrays.
CHUNK = 10_000
# Beside the two ends: two objectives, two counts, three outcomes, one time.
N_NUMBERS = 8


@declared
class SweepSearches:
    """The ends of N searches in p parameters, failed ones included.

    An *end* is what the optimizer gave back, whatever it is. Its *kind* says what is there:
    ``minimum`` if exact derivatives put the minimum within 0.01 typical steps (0.03 kN, 0.02 %),
    ``cliff`` if 0.01 typical steps down the way on the prediction is lost or has jumped,
    ``valley`` if the optimizer stopped though the way down is open, ``start_failed`` if it saw no
    prediction at all. Least squares with exact derivatives continues from there to the *polished*
    end.
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
        return len(self.starts)

    @property
    @derived("Simulations of all searches", unit="1", key="n_simulations")
    def total_simulations(self) -> int:
        return int(self.n_simulations.sum())

    @property
    @derived("Simulations of polishing all ends", unit="1", key="n_polishing")
    def total_polishing(self) -> int:
        return int(self.n_polishing.sum())

    @property
    @derived("Ends of each kind, of those that occur")
    def kinds(self) -> dict[str, int]:
        return self.counts(self.kind_codes)

    @property
    @derived("Searches by how they ended")
    def outcomes(self) -> dict[str, int]:
        return self.counts(self.outcome_codes)

    @property
    @derived("Polished ends by how the polishing ended")
    def polished_outcomes(self) -> dict[str, int]:
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
        Where finished searches are kept, from `identknee.runs.store.open_work`, opened
        with the problem and all that the starts follow from.

    Raises
    ------
    ValueError
        If the starts have another length, are not finite or are none, or the method or the budget
        is not possible. Searches that fail are no error: they are kept.
    """
    points = frozen(starts, None, problem.parameters.n, name="starts")
    allowed = BUDGET if budget is None else budget
    if len(points) == 0:
        raise ValueError("there is no start; give at least one")
    if not np.all(np.isfinite(points)):
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise ValueError(f"starts must be finite numbers, start {row} is {points[row].tolist()}")
    if method not in METHODS:
        raise ValueError(f"there is no method {method!r}; the methods are {', '.join(METHODS)}")
    if allowed < 1:
        raise ValueError(f"the budget must be at least 1 simulation, got {allowed}")
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
    p = problem.parameters.n
    numbers = rows[:, 2 * p :]
    return SweepSearches(
        method=method,
        budget=allowed,
        seed=seed,
        parameters=problem.parameters,
        starts=points,
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
        # With the same seed the second look for a way around a cliff would repeat the first.
        further = fit(problem, end.theta, seed=own + 1)
        polished = further if further.objective < end.objective else end
        # An end on a bound is moved inside, which may be beyond the cliff at it.
        last = kind if further.outcome is Outcome.START_FAILED else further.outcome
        if last is Outcome.VALLEY:
            last = classify_end(problem, polished)
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


# Unit of `distance`.
DISTANCE = "kN and %"
# Draws of one start before the bounds are said to leave no room at its distance.
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
            low, high = parameters.lower[of_group], parameters.upper[of_group]
            for _ in range(MAX_DRAWS):
                shares = generator.dirichlet(np.ones(of_group.size)) * of_group.size
                signs = generator.choice([-1.0, 1.0], of_group.size)
                values = middle[of_group] + signs * shares * span
                if np.all((values >= low) & (values <= high)):
                    break
            else:
                names = ", ".join(parameters.names[k] for k in of_group)
                raise ValueError(
                    f"the bounds of {names} leave no room for starts at a distance of "
                    f"{float(span.max()):g}; widen the bounds or choose smaller distances"
                )
            starts[i, of_group] = values
    return starts


def distance(thetas: ArrayLike, target: ArrayLike, parameters: Parameters) -> Array:
    """Distance of parameter sets from a given one, as in the paper, shape ``(...,)``.

    The mean absolute difference of the stiffnesses [kN] or of the reference strains [%], whichever
    is larger; parameters in other units count in typical steps, and nuisances do not count.
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
    """Kind of each parameter as a number, shape ``(p,)``: stiffness, strain, other."""
    kinds = [
        0 if name.endswith(STIFFNESS_UNIT) else 1 if name.endswith(STRAIN_UNIT) else 2
        for name in parameters.names
    ]
    return np.asarray(np.unique(kinds, return_inverse=True)[1], dtype=np.int64)


def _check_number(n: int) -> None:
    if n < 1:
        raise ValueError(f"the number of starts must be at least 1, got {n}")


# In typical steps (3 kN, 2 %): ends closer than this in every parameter are one minimum.
TOLERANCE = 0.01
# Points between two minima where a barrier is looked for, and how many minima next to one are
# looked at.
N_BETWEEN = 7
N_NEIGHBOURS = 3
# Share of the deviance, and the deviance itself, below which a barrier is rounding.
BARRIER_SHARE, BARRIER_FLOOR = 1e-6, 2e-9
NONE = -1
# Minima in the summary; all are among the arrays.
MOST_LISTED = 20


@declared
class Basin:
    """A minimum and the starts that lead to it."""

    theta: Array = array("The minimum", "parameter", unit=OF_PARAMETER)
    objective: float = entry("Half the sum of squares there", unit="1")
    share: Proportion = entry(
        "Share of all starts, failed ones included, whose polished end it is: the volume of the "
        "basin as a part of the volume that the starts fill evenly"
    )


@declared
class Basins:
    """The minima at the polished ends of searches, the lowest first."""

    parameter_names: tuple[str, ...] = array(
        "Names of the parameters", "parameter", is_in_arrays=False
    )
    basins: tuple[Basin, ...] = entry(
        "The minima, the lowest first", rows="basin", group="basins", is_in_json=False
    )
    labels: IntArray = array(
        "Place among the basins of each start; -1 where its polishing ended at no minimum",
        "start",
        dtype=int,
        key="basin",
    )

    @property
    @derived("Minima found", unit="1")
    def n_basins(self) -> int:
        return len(self.basins)

    @property
    @derived("The first twenty minima, with their starts and parameters", key="basins")
    def listed(self) -> list[Mapping[str, Any]]:
        return [
            {
                "objective": x.objective,
                "n_starts": x.share.count,
                "share": x.share.value,
                "share_lower": x.share.lower,
                "share_upper": x.share.upper,
                "parameters": dict(zip(self.parameter_names, x.theta.tolist(), strict=True)),
            }
            for x in self.basins[:MOST_LISTED]
        ]

    @override
    def __str__(self) -> str:
        """One line a basin."""
        lines = [
            f"basin {i}: objective {x.objective:.6g}, {x.share}" for i, x in enumerate(self.basins)
        ]
        return "\n".join(lines or ["no basin was found"])


def find_basins(problem: Problem, searches: SweepSearches) -> Basins:
    """The basins among the polished ends of searches.

    Ends that polishing calls minima are gathered from the lowest up: those within 0.01 typical
    steps (0.03 kN, 0.02 %) of one in every parameter are that minimum. Two minima with no barrier
    on the straight line between them are one too: where a direction changes nothing, the minimum
    is not a point.

    Parameters
    ----------
    problem
        That of the searches, to look for barriers; each pair of minima costs seven simulations, the
        starts cost none.
    searches
        The ends.
    """
    scales = typical_steps(searches.parameters)
    labels = np.full(searches.n, NONE, dtype=np.int64)
    leaders: list[int] = []
    left = np.flatnonzero(searches.is_polished)
    left = left[np.argsort(searches.polished_objectives[left], kind="stable")]
    while left.size:
        leader = int(left[0])
        away = np.abs(searches.polished[left] - searches.polished[leader]) / scales
        near = away.max(axis=1) <= TOLERANCE
        # The basin of a leader nearby without a barrier between, or else a new one.
        others = searches.polished[leaders]
        apart = np.max(np.abs(others - searches.polished[leader]) / scales, axis=1)
        for joined in np.argsort(apart, kind="stable")[:N_NEIGHBOURS].tolist():
            if not has_barrier(problem, others[joined], searches.polished[leader]):
                break
        else:
            joined = len(leaders)
            leaders.append(leader)
        labels[left[near]] = joined
        left = left[~near]
    counts = np.bincount(labels[labels != NONE], minlength=len(leaders))
    return Basins(
        parameter_names=searches.parameters.names,
        basins=tuple(
            Basin(
                theta=searches.polished[leader],
                objective=float(searches.polished_objectives[leader]),
                share=share(int(count), searches.n),
            )
            for leader, count in zip(leaders, counts, strict=True)
        ),
        labels=labels,
    )


def has_barrier(problem: Problem, first: Array, second: Array) -> bool:
    """Whether the deviance rises, or is lost, on the straight line between two points."""
    ends = [sum_of_squares(problem.residuals(x)) for x in (first, second)]
    highest = max(ends) * (1.0 + BARRIER_SHARE) + BARRIER_FLOOR
    for along in np.linspace(0.0, 1.0, N_BETWEEN + 2)[1:-1]:
        between = (1.0 - along) * first + along * second
        if not sum_of_squares(problem.residuals(between)) <= highest:
            return True
    return False


@declared
class UnseenMass:
    """Good-Turing estimate of the mass of unseen basins, among starts that end in any."""

    n: int = entry("Starts that ended in a basin", unit="1", key="n_starts")
    n_basins: int = entry("Basins seen", unit="1")
    n_once: int = entry("Basins seen by one start only", unit="1", key="n_basins_seen_once")
    estimate: float = entry(
        "Good and Turing's estimate of the share of starts that would show a new basin: basins "
        "seen once over starts; null without a start",
        unit="1",
    )
    upper: float = entry("Upper limit of that share at 95 % confidence", unit="1")


def unseen_mass(labels: IntArray) -> UnseenMass:
    """The unseen mass from the basin of each start, in the order in which the starts were drawn.

    The limit is that of the mass not seen by the first half of the starts: given those, each start
    of the second half shows a new basin with that probability, so that the Clopper-Pearson limit of
    the share that did is exact for independent starts, whatever the basins. All starts together
    leave no more unseen than the first half does. Starts of a Sobol sequence are spread more evenly
    than independent ones.

    References
    ----------
    .. [1] Good (1953), Biometrika 40(3-4), 237-264. https://doi.org/10.1093/biomet/40.3-4.237

    Examples
    --------
    >>> unseen_mass(np.array([0, 0, 1, 0, 0, 0, 0, 0])).estimate
    0.125
    """
    seen = labels[labels != NONE]
    counts = np.unique(seen, return_counts=True)[1]
    half = len(seen) // 2
    is_new = ~np.isin(seen[half:], seen[:half])
    # One-sided: the upper limit at 97.5 % of the two-sided one, so on the safe side.
    limit = share(int(is_new.sum()), len(is_new)).upper if half else 1.0
    once = int(np.sum(counts == 1))
    return UnseenMass(
        n=len(seen),
        n_basins=len(counts),
        n_once=once,
        estimate=once / len(seen) if len(seen) else float("nan"),
        upper=limit,
    )


MAX_SHELLS = 20
N_BINS = 10
# Nine of ten: fifty of fifty starts are enough to be sure of it.
OFTEN = 0.9


@declared
class Radius:
    """The radius within which a start recovers the target with a stated probability."""

    probability: float = entry("Probability stated", unit="1")
    value: float = entry(
        "Distance at which a falling curve through the shares crosses it; 0 where even the nearest "
        "starts recover less often, null where the farthest ones still recover as often",
        unit=DISTANCE,
    )
    lower: float = entry(
        "Where a curve through the lower 95 % limits of the shares crosses it", unit=DISTANCE
    )
    upper: float = entry("Where a curve through their upper limits does", unit=DISTANCE)


@declared
class Recovery:
    """Proportions of starts that recovered a target, by their distance from it."""

    distances: Array = array(
        "Mean distance from the target of the starts in each group, ascending",
        "distance",
        unit=DISTANCE,
        is_in_json=True,
    )
    shares: tuple[Proportion, ...] = entry(
        "Share of the starts in each group that recovered it", rows="distance"
    )

    @property
    @derived("Distance within which nine of ten starts recover it")
    def radius(self) -> Radius:
        return radius(self)


def is_recovered(
    searches: SweepSearches, target: Array, *, within: float, polished: bool = False
) -> BoolArray:
    """Which searches ended near the target, shape ``(N,)``.

    Parameters
    ----------
    searches
        The searches.
    target
        Truth or best fit, shape ``(p,)``.
    within
        How far the end may be by `distance`, in kN and %.
    polished
        Whether the polished end is meant, and not that of the optimizer.
    """
    ends = searches.polished if polished else searches.ends
    objectives = searches.polished_objectives if polished else searches.objectives
    near = distance(ends, target, searches.parameters) <= within
    return np.asarray(near & np.isfinite(objectives))


def recovery(distances: Array, recovered: BoolArray) -> Recovery:
    """The proportion recovered at each distance of the starts, or in ten groups of equal size.

    Parameters
    ----------
    distances
        Distances of the starts from the target, shape ``(N,)``. If at most twenty of them differ,
        they are taken as shells.
    recovered
        From `is_recovered`, shape ``(N,)``.
    """
    shells, place = np.unique(np.round(distances, 9), return_inverse=True)
    if len(shells) > MAX_SHELLS:
        order = np.argsort(distances, kind="stable")
        place = np.empty(len(distances), dtype=np.int64)
        place[order] = np.arange(len(distances)) * N_BINS // len(distances)
    groups = range(int(place.max()) + 1)
    return Recovery(
        distances=np.array([distances[place == k].mean() for k in groups]),
        shares=tuple(
            share(int(recovered[place == k].sum()), int(np.sum(place == k))) for k in groups
        ),
    )


def radius(found: Recovery, *, probability: float = OFTEN) -> Radius:
    """The distance within which starts recover the target with at least this probability.

    The curve is the falling one that fits the shares best (isotonic regression, each share weighted
    by its starts), straight between the distances.

    Raises
    ------
    ValueError
        If the probability is not between 0 and 1.

    References
    ----------
    .. [1] Barlow, Bartholomew, Bremner, Brunk (1972), Statistical inference under order
           restrictions, chapter 1. Wiley.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"the probability must be between 0 and 1, got {probability:g}")
    shares, lower, upper = (
        np.array([getattr(x, name) for x in found.shares]) for name in ("value", "lower", "upper")
    )
    weights = [x.n for x in found.shares]
    fitted = scipy.optimize.isotonic_regression(shares, weights=weights, increasing=False).x
    # The limits are made to fall with distance too, each to its safe side.
    curves = (fitted, np.minimum.accumulate(lower), np.maximum.accumulate(upper[::-1])[::-1])
    value, low, high = (_crossing(found.distances, curve, probability) for curve in curves)
    return Radius(probability=probability, value=value, lower=low, upper=high)


def _crossing(distances: Array, curve: Array, level: float) -> float:
    below = np.flatnonzero(curve < level)
    if below.size == 0:
        return np.inf
    first = int(below[0])
    if first == 0:
        return 0.0
    part = (curve[first - 1] - level) / (curve[first - 1] - curve[first])
    return float(distances[first - 1] + part * (distances[first] - distances[first - 1]))


END, POLISHED = "end", "polished"
WITHIN = 0.5


@declared
class Survey:
    """Searches, their basins, and how often they recovered the target."""

    searches: SweepSearches = entry("The searches", group="optimization", is_inline=True)
    basins: Basins = entry(
        "What their polished ends gather to", group="optimization", is_inline=True
    )
    target: Array | None = array(
        "Truth, or the lowest polished end; not there where no search had a prediction",
        "parameter",
        unit=OF_PARAMETER,
        default=None,
    )
    within: float = entry(
        "How close to the target an end has to be to have recovered it", unit=DISTANCE
    )
    recoveries: Mapping[str, Recovery] = entry(
        "How often that happens by the distance of the start, of the search itself (end) and of "
        "its polished end (polished); none without a target",
        rows="end",
        group="recovery",
        key="recovery",
    )

    @property
    @derived("Part of the start volume that leads to basins not seen yet", key="unseen_mass")
    def unseen(self) -> UnseenMass:
        return unseen_mass(self.basins.labels)


def survey(
    problem: Problem,
    searches: SweepSearches,
    *,
    target: ArrayLike | None = None,
    within: float = WITHIN,
) -> Survey:
    """The basins of many searches, and how often these recovered the target.

    Parameters
    ----------
    problem
        That of the searches.
    searches
        From `identknee.identify.sweep.sweep`.
    target
        The truth where it is known, shape ``(p,)``; the lowest polished end if None.
    within
        How close an end has to be by `distance`, in kN and %.
    """
    basins = find_basins(problem, searches)
    best, middle = searches.best, None
    if target is not None:
        middle = frozen(target, searches.parameters.n, name="the target")
    elif np.isfinite(searches.polished_objectives[best]):
        middle = searches.polished[best]
    recoveries: dict[str, Recovery] = {}
    if middle is not None:
        away = distance(searches.starts, middle, searches.parameters)
        for name in (END, POLISHED):
            is_back = is_recovered(searches, middle, within=within, polished=name == POLISHED)
            recoveries[name] = recovery(away, is_back)
    return Survey(
        searches=searches,
        basins=basins,
        target=middle,
        within=within,
        recoveries=recoveries,
    )
