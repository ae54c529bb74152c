"""What one method says of one parameter or force."""

from dataclasses import dataclass
from enum import Enum, unique

# Of a normal distribution, half of its central 95 %.
SDS_95 = 1.96
NOT_CONVERGED = "not converged"


@unique
class Source(Enum):
    """A method, the most telling first; the value is its name in a sentence."""

    PROFILE = "profile"
    POSTERIOR = "posterior"
    DIAGNOSIS = "diagnosis"
    CAUSE = "diagnosis with the cause"
    INFORMATION = "local approximation"
    EQUIVALENTS = "equivalent set"


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """What one method says of one quantity.

    Attributes
    ----------
    source
        The method.
    low, high
        Its 95 % set or range, in the unit of the quantity; None for an open end.
    value
        Its estimate; None where it has none.
    status
        What is known, in a word or three.
    reach
        The limit of the squared misfit that the range stands for, over the one of a 95 % set; a
        range of another limit is scaled by its root before it is compared. None where the two
        cannot be compared.
    """

    source: Source
    low: float | None
    high: float | None
    value: float | None
    status: str
    reach: float | None = 1.0

    @property
    def is_closed(self) -> bool:
        """Whether it has both ends."""
        return self.low is not None and self.high is not None

    @property
    def width(self) -> float:
        """From end to end; infinite where one is open."""
        if self.low is None or self.high is None:
            return float("inf")
        return self.high - self.low


def open_ends_text(low: float | None, high: float | None) -> str:
    """Which ends of a range are open.

    Examples
    --------
    >>> open_ends_text(1.0, 2.0), open_ends_text(1.0, None), open_ends_text(None, None)
    ('known', 'open above', 'not known')
    """
    if low is None:
        return "not known" if high is None else "open below"
    return "open above" if high is None else "known"
