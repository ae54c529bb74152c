"""What a profile found: the curve, the confidence set, and how each side ended."""

from enum import Enum, unique
from itertools import pairwise

import numpy as np
import scipy.optimize
from typing_extensions import override

from identknee.identify.profile.thresholds import threshold_below
from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import OF_PARAMETER, OF_QUANTITY, array, declared, derived, entry


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
class ProfileVerdict(Enum):
    """What the profile says about the quantity; the value is the word written to files."""

    IDENTIFIABLE = "identifiable"
    ONE_SIDED = "one_sided"
    PRACTICALLY_NONIDENTIFIABLE = "practically_nonidentifiable"
    STRUCTURALLY_SUSPECT = "structurally_suspect"
    MULTIMODAL = "multimodal"
    UNDETERMINED = "undetermined"

    @property
    def sentence(self) -> str:
        """What that means, as a full sentence."""
        return _VERDICTS[self]


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
    ProfileVerdict.ONE_SIDED: "The data bound the value on one side only.",
    ProfileVerdict.PRACTICALLY_NONIDENTIFIABLE: "These data bound the value on neither side.",
    ProfileVerdict.STRUCTURALLY_SUSPECT: (
        "Data of this kind cannot bound the value: they do not depend on it."
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

    @property
    @derived("What the status means")
    def sentence(self) -> str:
        """What the status means, as a full sentence."""
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
    optimum: Array = array("Theta of the best fit", "parameter", unit=OF_PARAMETER)
    better_optimum: Array | None = array(
        "A better fit than the one given, where the profile met one and started over from it",
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
        """The lower end; None where the set is open below."""
        return self.intervals[0][0]

    @property
    @derived("Upper end of the set; null where it is open", unit=OF_QUANTITY)
    def upper(self) -> float | None:
        """The upper end; None where the set is open above."""
        return self.intervals[-1][1]

    @property
    @derived("How the set ended below")
    def lower_status(self) -> SideStatus:
        """How the set ended below."""
        return self.lower_side.status

    @property
    @derived("How the set ended above")
    def upper_status(self) -> SideStatus:
        """How the set ended above."""
        return self.upper_side.status

    @property
    @derived("What the verdict means")
    def sentence(self) -> str:
        """What the verdict means, as a full sentence."""
        return self.verdict.sentence

    @property
    @derived("Points of the curve", unit="1")
    def n_points(self) -> int:
        """Number of points of the curve."""
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
            f"{self.verdict.sentence}"
        )


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.6g}"
