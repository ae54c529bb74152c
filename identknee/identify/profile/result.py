"""What a profile found, and the thresholds that bound its confidence set."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, unique
from functools import partial
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import ArrayLike
from typing_extensions import override

from identknee.calibrate.bounded_least_squares import minimise, solve_constrained
from identknee.calibrate.problem import Evaluator, Problem, ProblemAround, Quantity
from identknee.runs.declare import (
    OF_PARAMETER,
    OF_QUANTITY,
    Array,
    IntArray,
    array,
    declared,
    derived,
    entry,
)
from identknee.runs.executors import Executor, serial
from identknee.runs.findings import Doubt
from identknee.runs.store import Store, resumable_map

NewData = Callable[[np.random.SeedSequence], Problem]

# Of the deviance: what a fit may leave; the statistic is then right to 1e-4 of its quantile.
TOLERANCE = 2e-4
LIMITS_LEVEL = 0.95


def chi2_threshold(level: float, n_quantities: int = 1) -> float:
    """Rise of the deviance that bounds a set of confidence `level` where the noise is known.

    Parameters
    ----------
    level
        Confidence level, between 0 and 1.
    n_quantities
        How many numbers are held at once: 2 for a pair of parameters.

    Raises
    ------
    ValueError
        If the level is not between 0 and 1.

    Examples
    --------
    >>> round(chi2_threshold(0.95), 6)
    3.841459
    """
    _check_level(level)
    return float(scipy.stats.chi2.ppf(level, n_quantities))


def threshold_below(threshold: float, level: float, wanted: float, n_quantities: int = 1) -> float:
    """The threshold for a level up to that of another, in the chi-squared law's proportion.

    Parameters
    ----------
    threshold, level
        A threshold of any origin, and the level it stands for.
    wanted
        The level wanted, above 0 and up to `level`.
    n_quantities
        How many numbers are held at once.

    Raises
    ------
    ValueError
        If the level wanted is not one of those.

    Examples
    --------
    >>> round(threshold_below(3.841459, 0.95, 0.68), 3)
    0.989
    """
    if not 0.0 < wanted <= level:
        raise ValueError(
            f"the level must be above 0 and at most the profile's {level:g}, got {wanted:g}"
        )
    law = scipy.stats.chi2(n_quantities)
    return threshold * float(law.ppf(wanted) / law.ppf(level))


def f_threshold(level: float, degrees_of_freedom: int, n_quantities: int = 1) -> float:
    """Rise of the deviance that bounds a set where the noise is estimated from the residuals.

    The rise of the deviance, in units of the estimated noise, divided by `n_quantities` has an F
    distribution for a linear model.

    Parameters
    ----------
    level
        Confidence level, between 0 and 1.
    degrees_of_freedom
        Degrees of freedom of the noise estimate: residuals minus the parameters they determine.
    n_quantities
        How many numbers are held at once.

    Raises
    ------
    ValueError
        If the level is not between 0 and 1, or there is no degree of freedom.

    References
    ----------
    D. M. Bates and D. G. Watts, Nonlinear Regression Analysis and Its Applications (1988),
    section 6.1.2, doi:10.1002/9780470316757.

    Examples
    --------
    >>> round(f_threshold(0.95, 10), 4)
    4.9646
    """
    _check_level(level)
    if degrees_of_freedom < 1:
        raise ValueError(
            f"the noise needs at least 1 degree of freedom, got {degrees_of_freedom}; "
            "measure more or hold parameters"
        )
    return n_quantities * float(scipy.stats.f.ppf(level, n_quantities, degrees_of_freedom))


@declared
class BootstrapStatistics:
    """Parametric bootstrap of the likelihood ratio at one parameter set."""

    names: tuple[str, ...] = array("Names of the quantities", "quantity", is_in_arrays=False)
    statistics: Array = array(
        "Rise of the deviance when a quantity is held at its true value, one row a data set; "
        "infinite where the model has no fit there, NaN where the data have no fit",
        *("data_set", "quantity"),
    )

    @property
    def n_failed(self) -> int:
        """Data sets without a fit, left out of the quantiles."""
        return int(np.isnan(self.statistics).any(axis=1).sum())

    def thresholds(self, level: float) -> Array:
        """Rise of the deviance that bounds a set of this level, with its limits, shape ``(q, 3)``.

        The first column is the threshold, the others are its 95 % confidence limits from the order
        of the statistics.

        Raises
        ------
        ValueError
            If the data sets are too few for the level.
        """
        _check_level(level)
        complete = self.statistics[~np.isnan(self.statistics).any(axis=1)]
        if len(complete) * min(level, 1.0 - level) < 1.0:
            raise ValueError(
                f"{len(complete)} data sets do not determine a quantile at {level:g}; use "
                f"{math.ceil(1.0 / min(level, 1.0 - level))} or more"
            )
        # Places among n sorted values of a quantile, and of its lower and upper limit.
        n = len(complete)
        tail = 0.5 * (1.0 - LIMITS_LEVEL)
        law = scipy.stats.binom(n, level)
        places = (np.ceil(n * level) - 1, law.ppf(tail) - 1, law.ppf(1.0 - tail))
        return np.sort(complete, axis=0)[[int(np.clip(x, 0, n - 1)) for x in places]].T


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResimulatedProblem(ProblemAround):
    """A problem with data simulated at one parameter set.

    Attributes
    ----------
    problem
        Residuals in units of their noise; they must depend on the data by subtraction alone.
    shift
        What is subtracted from its residuals, shape ``(m,)``.
    """

    shift: Array

    @override
    def residuals(self, theta: Array) -> Array:
        """Residuals against the new data, shape ``(m,)``."""
        return np.asarray(self.problem.residuals(theta) - self.shift)


def resimulated(problem: Problem, truth: Array, seed: np.random.SeedSequence) -> ResimulatedProblem:
    """The problem with data simulated at `truth`: its prediction there plus standard normal noise.

    With the first two arguments bound it is what `bootstrap_statistics` asks for.

    Raises
    ------
    ValueError
        If the model has no prediction at `truth`.
    """
    at_truth = np.asarray(problem.residuals(np.asarray(truth, dtype=np.float64)))
    if not np.isfinite(at_truth).all():
        raise ValueError("the model has no prediction at the parameter set to simulate data at")
    noise = np.random.default_rng(seed).standard_normal(at_truth.size)
    return ResimulatedProblem(problem=problem, shift=at_truth + noise)


def bootstrap_statistics(
    new_data: NewData,
    truth: ArrayLike,
    quantities: Sequence[Quantity],
    *,
    n: int = 1000,
    seed: int = 0,
    executor: Executor = serial,
    store: Store | None = None,
) -> BootstrapStatistics:
    """Likelihood ratios whose quantiles are thresholds for this model and these few data.

    The likelihood ratio of each quantity's true value is computed for data sets simulated at
    `truth`; its quantile takes the place of that of the chi-squared law, which it approaches as
    data grow. All quantities share the same data sets: one fit each, and one more a quantity.

    Parameters
    ----------
    new_data
        Function from a seed to the problem with new data simulated at `truth`, residuals in units
        of their noise; from the top of a module if `executor` runs processes.
    truth
        Theta of the simulated data, shape ``(p,)``: the best fit to the measured ones.
    quantities
        Each gets a column of its own.
    n
        How many data sets.
    seed
        Seed of the data sets.
    executor
        Anything with an ordered ``map``.
    store
        Where finished data sets are kept; from `identknee.runs.store.open_work`.

    References
    ----------
    C. Toensing, B. Steiert, J. Timmer and C. Kreutz, Likelihood-ratio test statistic for the
    finite-sample case in nonlinear ordinary differential equation models, PLoS Computational
    Biology 19 (2023) e1011417, doi:10.1371/journal.pcbi.1011417.
    """
    theta = np.asarray(truth, dtype=np.float64)
    rows = resumable_map(
        partial(_statistics, new_data, theta, tuple(quantities)),
        [(seed, i) for i in range(n)],
        executor=executor,
        store=store,
        name="bootstrap",
        description="simulating data anew",
    )
    return BootstrapStatistics(
        names=tuple(x.name for x in quantities),
        statistics=np.array(rows, dtype=np.float64).reshape(n, len(quantities)),
    )


def _statistics(
    new_data: NewData, truth: Array, quantities: Sequence[Quantity], seed: tuple[int, int]
) -> list[float]:
    entropy, key = seed
    evaluator = Evaluator(new_data(np.random.SeedSequence(entropy, spawn_key=(key,))))
    best = minimise(evaluator, truth, tolerance=TOLERANCE)
    lowest = best.evaluation.deviance
    start, held = best.evaluation.theta if np.isfinite(lowest) else truth, []
    for quantity in quantities:
        target = quantity.evaluate(truth)[0]
        solved = solve_constrained(
            evaluator, start, quantity=quantity, target=target, tolerance=TOLERANCE
        )
        held.append(solved.evaluation.deviance if solved.is_on_target else np.inf)
    # A fit that is held may have found its way to where the free one did not.
    lowest = min([lowest, *held])
    return [x - lowest if np.isfinite(lowest) else np.nan for x in held]


def _check_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise ValueError(f"the level must be between 0 and 1, got {level:g}")


def cubic(x: float, left: tuple[float, float, float], right: tuple[float, float, float]) -> float:
    """Value at `x` of the cubic through two points, each given as (place, value, slope).

    Examples
    --------
    >>> cubic(0.5, (0.0, 0.0, 0.0), (1.0, 1.0, 3.0))
    0.125
    """
    (a, f, slope_f), (b, g, slope_g) = left, right
    width = b - a
    u = (x - a) / width
    return float(
        (1 + 2 * u) * (1 - u) ** 2 * f
        + u * (1 - u) ** 2 * width * slope_f
        + u**2 * (3 - 2 * u) * g
        + u**2 * (u - 1) * width * slope_g
    )


def crossings(places: Array, values: Array, slopes: Array, level: float) -> list[float]:
    """Where the piecewise cubic through points with slopes crosses `level`, from low to high.

    Between two points on different sides of the level there is one crossing; others are not sought.
    """
    found = []
    points = list(zip(places.tolist(), values.tolist(), slopes.tolist(), strict=True))
    for left, right in pairwise(points):
        if (left[1] < level) != (right[1] < level):
            found.append(
                float(
                    scipy.optimize.brentq(
                        lambda x, a=left, b=right: cubic(x, a, b) - level, left[0], right[0]
                    )
                )
            )
    return found


Interval = tuple[float | None, float | None]


@unique
class SideStatus(Enum):
    """How the profile ended on one side; the value is the word written to files."""

    CLOSED = "closed"
    OPEN_AT_BOUND = "open_at_bound"
    OPEN_FLAT = "open_flat"
    OPEN_AT_FEASIBILITY = "open_at_feasibility"
    OPEN_BUDGET = "open_budget"
    FAILED = "failed"

    @property
    def sentence(self) -> str:
        """What that means, as a full sentence."""
        return _SIDES[self]


@unique
class EndOrigin(Enum):
    """What makes an end of a profile; the value is the word written to files."""

    DATA = "data"
    PRIOR = "prior"
    LIMIT = "limit"
    BOUND = "bound"
    OWN_BOUND = "own_bound"
    FEASIBILITY = "feasibility"


@unique
class ProfileVerdict(Enum):
    """What the profile says about the quantity; the value is the word written to files."""

    IDENTIFIABLE = "identifiable"
    BOUNDED_BY_ASSUMPTION = "bounded_by_assumption"
    ONE_SIDED = "one_sided"
    PRACTICALLY_NONIDENTIFIABLE = "practically_nonidentifiable"
    STRUCTURALLY_SUSPECT = "structurally_suspect"
    MULTIMODAL = "multimodal"
    UNDETERMINED = "undetermined"

    @property
    def sentence(self) -> str:
        """What that means, as a full sentence."""
        return _VERDICTS[self]


_BELIEFS = {EndOrigin.PRIOR: "Priors", EndOrigin.LIMIT: "Limits of plausibility"}
_SIDES = {
    SideStatus.CLOSED: "The data exclude every value beyond this end.",
    SideStatus.OPEN_AT_BOUND: "The data exclude no value up to the bound or the end of the range.",
    SideStatus.OPEN_FLAT: "The data exclude no value on this side: the misfit stopped rising.",
    SideStatus.OPEN_AT_FEASIBILITY: (
        "The model limits the set here, not the data: parameter sets beyond that would fit have no "
        "prediction in some trial."
    ),
    SideStatus.OPEN_BUDGET: "The budget of simulations was exhausted before this end was found.",
    SideStatus.FAILED: "The constrained fits on this side failed before an end was found.",
}
_VERDICTS = {
    ProfileVerdict.IDENTIFIABLE: "The data bound the value on both sides.",
    ProfileVerdict.BOUNDED_BY_ASSUMPTION: (
        "The data alone do not make this set: an end of it depends on a prior, on limits of "
        "plausibility or on the bound of another parameter."
    ),
    ProfileVerdict.ONE_SIDED: "The data bound the value on one side only.",
    ProfileVerdict.PRACTICALLY_NONIDENTIFIABLE: "These data bound the value on neither side.",
    ProfileVerdict.STRUCTURALLY_SUSPECT: (
        "Data of this kind cannot bound the value: they do not depend on it, or other parameters "
        "make up for it."
    ),
    ProfileVerdict.MULTIMODAL: "The confidence set has several separate intervals.",
    ProfileVerdict.UNDETERMINED: "One side was not completed, so there is no verdict.",
}


@declared
class Side:
    """The end of a profile on one side, with the numbers behind its status."""

    status: SideStatus = entry("How it ended")
    end: float | None = entry(
        "Last value of the confidence set; null where the side is not closed", unit=OF_QUANTITY
    )
    error: float = entry(
        "How far the end may be off by the tolerances of its solution; null where not closed",
        unit=OF_QUANTITY,
    )
    reached: float = entry(
        "Outermost value at which the profile was computed; at an end open at the feasibility "
        "boundary of the model, where that boundary lies",
        unit=OF_QUANTITY,
    )
    max_deviance: float = entry(
        "Largest rise of the deviance between the optimum and there", unit="1"
    )
    at_bounds: tuple[str, ...] = entry(
        "Other parameters that sit on a bound there: the end is then a statement about the box too"
    )
    made_by: EndOrigin | None = entry(
        "What makes the end: data; prior or limit, where more than half of the rise of the "
        "deviance from the best fit to the end is that of priors or limits of plausibility; "
        "bound, where it moves by more than a tenth of the interval once the bounds of other "
        "parameters have twice their room; null where "
        "nothing was found to",
        default=None,
    )
    bound_of: str | None = entry(
        "The other parameter on whose bound the end hangs; of several the one that moves it most",
        default=None,
    )

    @property
    @derived("What makes the end, in a word or with the name of the parameter: bound of NAME")
    def origin(self) -> str | None:
        """What makes the end; None where nothing was found to."""
        if self.bound_of is not None:
            return f"bound of {self.bound_of}"
        return None if self.made_by is None else self.made_by.value

    @property
    @derived("What status and origin mean")
    def sentence(self) -> str:
        if self.bound_of is not None:
            return (
                f"This end depends on the bound of {self.bound_of}: with twice its room the end "
                "moves by more than a tenth of the interval."
            )
        if self.made_by is EndOrigin.PRIOR:
            return "More than half of what excludes the values beyond this end is priors, not data."
        if self.made_by is EndOrigin.LIMIT:
            return (
                "More than half of what excludes the values beyond this end is limits of "
                "plausibility, not data."
            )
        return self.status.sentence


@declared
class Profile:
    """The best fit at each value of a quantity, and the values that the data do not exclude."""

    name: str = entry("Name of the quantity")
    unit: str = entry("Unit of the quantity")
    optimum_value: float = entry("The quantity at the best fit", unit=OF_QUANTITY, key="value")
    intervals: tuple[Interval, ...] = entry(
        "Confidence set as separate intervals from low to high, each lower and upper end; null "
        "for an open end",
        unit=OF_QUANTITY,
    )
    lower_side: Side = entry("How the set ended below")
    upper_side: Side = entry("How the set ended above")
    verdict: ProfileVerdict = entry("What that means for the quantity")
    level: float = entry("Confidence level of the set", unit="1")
    threshold: float = entry("Rise of the deviance that bounds the set", unit="1")
    practical_level: float = entry(
        "Largest confidence level known to close on both sides", unit="1"
    )
    deviance: float = entry("Deviance of the best fit", unit="1")
    n_simulations: int = entry("Simulations made, each with its Jacobian", unit="1")
    n_restarts: int = entry("How often the profile started over from a better fit", unit="1")
    conditional_on_misfit: bool = entry(
        "Whether the model leaves more misfit than the noise (p < 0.05): all ends then hold only "
        "as far as that misfit does not matter",
        default=False,
    )
    at_implausible_fit: bool = entry(
        "Whether forces, strains or contact of the best fit are those of no knee", default=False
    )
    optimum: Array = array("Theta of the best fit", "parameter", unit=OF_PARAMETER)
    better_optimum: Array | None = array(
        "A better fit than the one given, where the profile met one: it is the optimum",
        "parameter",
        unit=OF_PARAMETER,
        default=None,
    )
    values: Array = array(
        "The quantity along the curve, from low to high", "point", unit=OF_QUANTITY
    )
    thetas: Array = array(
        "Parameters of the best fit with that value",
        *("point", "parameter"),
        unit=OF_PARAMETER,
        key="theta",
    )
    deltas: Array = array("Rise of the deviance above the best fit", "point", key="delta_deviance")
    slopes: Array = array(
        "Exact derivative of the rise by the quantity; of the chords where a fit stopped at the "
        "feasibility boundary",
        "point",
        unit="1 over the unit of the quantity",
        key="slope",
    )
    branches: IntArray = array(
        "Local optimum to whose path each point belongs; 0 is the best fit",
        "point",
        dtype=int,
        key="branch",
    )

    @property
    @derived("Lower end of the set; null where it is open", unit=OF_QUANTITY)
    def lower(self) -> float | None:
        return self.intervals[0][0]

    @property
    @derived("Upper end of the set; null where it is open", unit=OF_QUANTITY)
    def upper(self) -> float | None:
        return self.intervals[-1][1]

    @property
    @derived("How the set ended below")
    def lower_status(self) -> SideStatus:
        return self.lower_side.status

    @property
    @derived("How the set ended above")
    def upper_status(self) -> SideStatus:
        return self.upper_side.status

    @property
    @derived("What makes the lower end")
    def lower_origin(self) -> str | None:
        """What makes the lower end; None where nothing was found to."""
        return self.lower_side.origin

    @property
    @derived("What makes the upper end")
    def upper_origin(self) -> str | None:
        """What makes the upper end; None where nothing was found to."""
        return self.upper_side.origin

    @property
    def doubt(self) -> Doubt | None:
        """Why nothing is known whatever the ends; None at a sound fit."""
        if self.conditional_on_misfit:
            return Doubt.MISFIT
        return Doubt.IMPLAUSIBLE if self.at_implausible_fit else None

    @property
    def is_known(self) -> bool:
        """Whether the data make both ends, at a fit that is neither rejected nor implausible."""
        return self.verdict is ProfileVerdict.IDENTIFIABLE and self.doubt is None

    @property
    def verdict_words(self) -> str:
        """The verdict in words, with what makes it doubtful."""
        words = self.verdict.value.replace("_", " ")
        return words if self.doubt is None else f"{words}, {self.doubt.value}"

    @property
    @derived("What the verdict means")
    def sentence(self) -> str:
        ends = (("lower", self.lower_side), ("upper", self.upper_side))
        sentences = [
            f"The {which} end depends on the bound of {side.bound_of}."
            for which, side in ends
            if side.bound_of is not None
        ]
        sentences += [
            f"{_BELIEFS[side.made_by]} make most of the {which} end."
            for which, side in ends
            if side.made_by in _BELIEFS
        ]
        sentences += [] if self.doubt is None else [f"That is {self.doubt.value}."]
        return " ".join([self.verdict.sentence, *sentences])

    @property
    @derived("Points of the curve", unit="1")
    def n_points(self) -> int:
        return len(self.values)

    @property
    def z(self) -> Array:
        """Signed root of the deviance's rise at each point, shape ``(k,)``."""
        return np.sign(self.values - self.optimum_value) * np.sqrt(np.maximum(self.deltas, 0.0))

    def intervals_at(self, level: float) -> tuple[Interval, ...]:
        """The confidence set at a lower confidence level, read off the curve.

        Between points the curve is the cubic of their deviances and slopes. The threshold keeps the
        proportion to this profile's own that a chi-squared law gives.

        Raises
        ------
        ValueError
            If `level` is not above 0 or is above the profile's own.
        """
        threshold = threshold_below(self.threshold, self.level, level)
        if level == self.level:
            return self.intervals
        edges = crossings(self.values, self.deltas, self.slopes, threshold)
        ends: list[float | None] = [float(x) for x in edges]
        if self.deltas[0] < threshold:
            ends.insert(0, None)
        if self.deltas[-1] < threshold:
            ends.append(None)
        return tuple(zip(ends[0::2], ends[1::2], strict=True))

    @override
    def __str__(self) -> str:
        """A line: the set and the verdict."""
        parts = " and ".join(f"{_end(low)} to {_end(high)}" for low, high in self.intervals)
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.name}: {self.optimum_value:.6g}{unit}, {self.level:.0%} set {parts}. "
            f"{self.sentence}"
        )


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.6g}"
