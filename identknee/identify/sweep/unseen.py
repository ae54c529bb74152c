"""How much of the start volume leads to basins that no start has shown yet."""

import numpy as np

from identknee.identify.shares import share
from identknee.identify.sweep.basins import NONE
from identknee.runs.arrays import IntArray
from identknee.runs.declare import declared, entry


@declared
class Unseen:
    """The mass of basins not seen, among starts that lead to any."""

    n: int = entry("Starts that ended in a basin", unit="1", key="n_starts")
    n_basins: int = entry("Basins seen", unit="1")
    n_once: int = entry("Basins seen by one start only", unit="1", key="n_basins_seen_once")
    estimate: float = entry(
        "Good and Turing's estimate of the share of starts that would show a new basin: basins "
        "seen once over starts; null without a start",
        unit="1",
    )
    upper: float = entry("Upper limit of that share at 95 % confidence", unit="1")


def unseen_mass(labels: IntArray) -> Unseen:
    """The unseen mass from the basin of each start, in the order in which the starts were drawn.

    The limit is that of the mass not seen by the first half of the starts: given those, each start
    of the second half shows a new basin with that probability, so that the Clopper-Pearson limit of
    the share that did is exact for independent starts, whatever the basins. All starts together
    leave no more unseen than the first half does. Starts of a Sobol sequence are spread more evenly
    than independent ones.

    Parameters
    ----------
    labels
        From `identknee.identify.sweep.basins.find_basins`, shape ``(N,)``; -1 is left out.

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
    return Unseen(
        n=len(seen),
        n_basins=len(counts),
        n_once=once,
        estimate=once / len(seen) if len(seen) else float("nan"),
        upper=limit,
    )
