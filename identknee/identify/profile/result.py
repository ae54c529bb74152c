"""What a profile found: the curve, the set of likely values, and how each side ended."""

from dataclasses import dataclass
from enum import Enum, unique

import numpy as np

from identknee.identify.profile.hermite import crossings
from identknee.identify.profile.thresholds import threshold_below
from identknee.runs.arrays import Array, IntArray, frozen, frozen_integers

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
class Verdict(Enum):
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
        "The model ends the set here, not the data: parameter sets beyond that would fit have no "
        "prediction in some trial."
    ),
    SideStatus.OPEN_BUDGET: "The budget of simulations was used up before this end was found.",
    SideStatus.FAILED: "The constrained fits on this side failed before an end was found.",
}
_VERDICTS = {
    Verdict.IDENTIFIABLE: "The data bound the value on both sides.",
    Verdict.ONE_SIDED: "The data bound the value on one side only.",
    Verdict.PRACTICALLY_NONIDENTIFIABLE: "These data bound the value on neither side.",
    Verdict.STRUCTURALLY_SUSPECT: "No such data may bound the value: they do not depend on it.",
    Verdict.MULTIMODAL: "The likely values form several separate intervals.",
    Verdict.UNDETERMINED: "A side was not finished, so nothing is claimed.",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Side:
    """The end of a profile on one side, with the numbers behind its status.

    Attributes
    ----------
    status
        How it ended.
    end
        The last likely value; None where the side is not closed.
    error
        How far the end may be off by the tolerances of its solution, in the quantity's unit; NaN
        where the side is not closed.
    reached
        The outermost value at which the profile was computed. Where the side is open at the
        feasibility boundary of the model, that is where the boundary lies.
    max_deviance
        Largest rise of the deviance between the optimum and there.
    at_bounds
        Parameters, other than the profiled one, that sit on a bound there: the end is then a
        statement about the box too.
    """

    status: SideStatus
    end: float | None
    error: float
    reached: float
    max_deviance: float
    at_bounds: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What that means, as a full sentence."""
        return self.status.sentence


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile:
    """The best fit at each value of a quantity, and the values that the data do not exclude.

    Attributes
    ----------
    name, unit
        Of the quantity.
    level, threshold
        Confidence level of the set, and the rise of the deviance that bounds it.
    optimum, optimum_value, deviance
        Theta of the best fit, shape ``(n,)``, the quantity there, and its deviance.
    values, thetas, deltas
        The curve from low to high values, shape ``(k,)``: the quantity, the parameters of the best
        fit with that value, shape ``(k, n)``, and the rise of the deviance above the best fit.
    slopes
        Exact derivative of `deltas` by `values`, shape ``(k,)``; of the chords where a fit stopped
        at the feasibility boundary.
    branches
        To which local optimum's path each point belongs, shape ``(k,)``; 0 is the best fit's.
    intervals
        The set of likely values as separate intervals from low to high; None for an open end.
    lower_side, upper_side
        How the set ended below and above.
    verdict
        What that means for the quantity.
    practical_level
        The largest confidence level known to close on both sides: `level` where both ends are
        closed, less where one is not.
    n_simulations
        Simulations made, each with its Jacobian.
    better_optimum
        A better fit than the one given, where the profile met one and started over from it.
    n_restarts
        How often that happened.
    """

    name: str
    unit: str
    level: float
    threshold: float
    optimum: Array
    optimum_value: float
    deviance: float
    values: Array
    thetas: Array
    deltas: Array
    slopes: Array
    branches: IntArray
    intervals: tuple[Interval, ...]
    lower_side: Side
    upper_side: Side
    verdict: Verdict
    practical_level: float
    n_simulations: int
    better_optimum: Array | None
    n_restarts: int

    def __post_init__(self) -> None:
        k, n = len(self.values), len(self.optimum)
        for field, shape in (
            ("optimum", (n,)),
            ("values", (k,)),
            ("thetas", (k, n)),
            ("deltas", (k,)),
            ("slopes", (k,)),
        ):
            object.__setattr__(self, field, frozen(getattr(self, field), *shape, name=field))
        object.__setattr__(self, "branches", frozen_integers(self.branches))

    @property
    def lower(self) -> float | None:
        """The least likely value; None where the set is open below."""
        return self.intervals[0][0]

    @property
    def upper(self) -> float | None:
        """The greatest likely value; None where the set is open above."""
        return self.intervals[-1][1]

    @property
    def lower_status(self) -> SideStatus:
        """How the set ended below."""
        return self.lower_side.status

    @property
    def upper_status(self) -> SideStatus:
        """How the set ended above."""
        return self.upper_side.status

    @property
    def z(self) -> Array:
        """Signed root of the deviance's rise at each point, shape ``(k,)``."""
        return np.sign(self.values - self.optimum_value) * np.sqrt(np.maximum(self.deltas, 0.0))

    def intervals_at(self, level: float) -> tuple[Interval, ...]:
        """The set of likely values at a lower confidence level, read off the curve.

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

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """A line: the set and the verdict."""
        parts = " and ".join(f"{_end(low)} to {_end(high)}" for low, high in self.intervals)
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.name}: {self.optimum_value:.6g}{unit}, {self.level:.0%} set {parts}. "
            f"{self.verdict.sentence}"
        )


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.6g}"
