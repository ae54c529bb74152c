"""Whether methods agree on a quantity, and if not how they differ."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum, unique
from math import inf, isinf, sqrt

from identknee.report.range import NOT_CONVERGED, Range, Source
from identknee.runs.words import interval, listed

# Ends as near as this share of a set's width are the same for every purpose.
NEAR = 0.15


@unique
class Relation(Enum):
    """How one range lies to another; the value follows the name of its method."""

    SAME = "agrees"
    NARROWER = "is narrower"
    WIDER = "is wider"
    LOWER = "lies lower"
    HIGHER = "lies higher"
    APART = "contradicts"
    CLOSED = "closes it"
    OPEN = "leaves it open"


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """What other methods say of a quantity beside the main one.

    Attributes
    ----------
    main
        What the table shows.
    others
        Every other method with how it lies to it.
    """

    main: Range
    others: tuple[tuple[Range, Relation], ...]

    @property
    def differing(self) -> tuple[tuple[Range, Relation], ...]:
        """Those that do not agree."""
        return tuple(x for x in self.others if x[1] is not Relation.SAME)

    @property
    def is_contradicted(self) -> bool:
        """Whether a method with the same model excludes all that the main one allows."""
        return any(y is Relation.APART and x.source is not Source.CAUSE for x, y in self.others)

    @property
    def is_moved_by_cause(self) -> bool:
        """Whether the model with a cause excludes all that the one without allows."""
        return any(y is Relation.APART and x.source is Source.CAUSE for x, y in self.others)

    def sentence(self, unit: str) -> str:
        """Which methods agree, and how the others differ.

        Parameters
        ----------
        unit
            Unit of the quantity.
        """
        n = 1 + len(self.others)
        if n == 1:
            return f"{self.main.source.value} only"
        agreeing = n - len(self.differing)
        if agreeing == n:
            return f"{'both' if n == 2 else f'all {n}'} agree"
        parts = [f"{agreeing} of {n} agree"] if agreeing > 1 else []
        parts += [
            f"{x.source.value} {relation.value} ({_range(x, unit)})"
            for x, relation in self.differing
        ]
        return "; ".join(parts)


def agreement(ranges: Sequence[Range]) -> Agreement:
    """The first of these ranges, and how each of the others lies to it."""
    main, *others = ranges
    return Agreement(main=main, others=tuple((x, relation(main, x)) for x in others))


def relation(main: Range, other: Range) -> Relation:
    """How `other` lies to `main`, scaled to the same limit of misfit where that is known."""
    (low, high), (own_low, own_high) = (
        _with_infinities(x) for x in (_scaled(other), (main.low, main.high))
    )
    if high < own_low or low > own_high:
        return Relation.APART
    if (isinf(low) and not isinf(own_low)) or (isinf(high) and not isinf(own_high)):
        return Relation.OPEN
    if isinf(own_low) or isinf(own_high):
        is_same = isinf(own_low) == isinf(low) and isinf(own_high) == isinf(high)
        return Relation.SAME if is_same else Relation.CLOSED
    slack = NEAR * (own_high - own_low)
    below, above = own_low - low, high - own_high
    if abs(below) <= slack and abs(above) <= slack:
        return Relation.SAME
    if min(below, above) > -slack and below + above > slack:
        return Relation.WIDER
    if max(below, above) <= slack and below + above < -slack:
        return Relation.NARROWER
    return Relation.HIGHER if above > below else Relation.LOWER


def reasons(agreements: Iterable[Agreement]) -> str:
    """Which methods are compared and why some differ, in one line; empty where one stands alone."""
    seen = list(agreements)
    ranges = [x for own in seen for x in (own.main, *(other for other, _ in own.others))]
    sources = [x for x in Source if any(y.source is x for y in ranges)]
    if len(sources) < 2:
        return ""
    differing = {x.source for own in seen for x, _ in own.differing}
    said = [f"Methods compared: {listed(x.value for x in sources)}."]
    said += [_WHY[x] for x in sources if x in differing and x in _WHY]
    if any(x.status == NOT_CONVERGED for x in ranges):
        said.append("The posterior has not converged yet.")
    scales = sorted({x.reach for x in ranges if x.reach not in (None, 1.0)} - {None})
    said += [
        f"Equivalent sets reach to {x:.2g} times the squared misfit that ends a 95 % set; for the "
        "comparison they are scaled to the same misfit."
        for x in scales
    ]
    return " ".join(said)


_WHY = {
    Source.POSTERIOR: "The posterior adds the prior to the data.",
    Source.DIAGNOSIS: "The diagnosis takes the noise from the scatter of the data, and the model "
    "as linear near the fit.",
    Source.CAUSE: "With the cause the model is another one, so its values may differ.",
    Source.INFORMATION: "The local approximation takes the model as linear near the fit.",
    Source.EQUIVALENTS: "Equivalent sets ask how far the fit can move, not what the data exclude.",
}


def _with_infinities(ends: tuple[float | None, float | None]) -> tuple[float, float]:
    low, high = ends
    return -inf if low is None else low, inf if high is None else high


def _scaled(x: Range) -> tuple[float | None, float | None]:
    if x.low is None or x.high is None or x.value is None or x.reach in (None, 1.0):
        return x.low, x.high
    factor = 1.0 / sqrt(x.reach or 1.0)
    return x.value + factor * (x.low - x.value), x.value + factor * (x.high - x.value)


def _range(x: Range, unit: str) -> str:
    return interval((x.low, x.high), unit)
