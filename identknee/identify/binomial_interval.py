"""A binomial proportion with its exact confidence limits."""

import scipy
from typing_extensions import override

from identknee.runs.declare import declared, derived, entry

LEVEL = 0.95


@declared
class Proportion:
    """A binomial proportion with Clopper-Pearson limits."""

    count: int = entry("How many", unit="1")
    n: int = entry("Of how many", unit="1")
    lower: float = entry(
        "Lower limit of the share at 95 % confidence; 0 where the sample is empty", unit="1"
    )
    upper: float = entry(
        "Upper limit of the share at 95 % confidence; 1 where the sample is empty", unit="1"
    )

    @property
    @derived("Share in the sample; null where that is empty", unit="1", key="share")
    def value(self) -> float:
        """The proportion in the sample; NaN for an empty one."""
        return self.count / self.n if self.n else float("nan")

    @override
    def __str__(self) -> str:
        """Count and limits, for people."""
        if not self.n:
            return "none of none"
        limits = f"95 %: {100 * self.lower:.1f} to {100 * self.upper:.1f} %"
        return f"{self.count} of {self.n}, {100 * self.value:.1f} % ({limits})"


def share(count: int, n: int) -> Proportion:
    """The proportion `count` of `n`, with its limits.

    Raises
    ------
    ValueError
        If `count` is not from 0 to `n`.

    References
    ----------
    .. [1] Clopper and Pearson (1934), Biometrika 26(4), 404-413.
           https://doi.org/10.1093/biomet/26.4.404

    Examples
    --------
    >>> print(share(0, 100))
    0 of 100, 0.0 % (95 %: 0.0 to 3.6 %)
    """
    if not 0 <= count <= n:
        raise ValueError(f"a share must be from 0 to {n} of {n}, got {count}")
    if n == 0:
        return Proportion(count=0, n=0, lower=0.0, upper=1.0)
    limits = scipy.stats.binomtest(count, n).proportion_ci(LEVEL, method="exact")
    return Proportion(count=count, n=n, lower=float(limits.low), upper=float(limits.high))
