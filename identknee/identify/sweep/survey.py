"""What searches say of the landscape: its basins, what is unseen, and how close to start."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.problem import Problem
from identknee.identify.sweep.basins import Basins, find_basins
from identknee.identify.sweep.recovery import Recovery, is_recovered, recovery
from identknee.identify.sweep.starts_design import DISTANCE, distance
from identknee.identify.sweep.sweep import Searches
from identknee.identify.sweep.unseen import Unseen, unseen_mass
from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import OF_PARAMETER, array, declared, derived, entry

END, POLISHED = "end", "polished"
WITHIN = 0.5


@declared
class Survey:
    """Searches and what is read from them."""

    searches: Searches = entry("The searches", group="optimization", is_inline=True)
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
    def unseen(self) -> Unseen:
        """The unseen mass."""
        return unseen_mass(self.basins.labels)


def survey(
    problem: Problem,
    searches: Searches,
    *,
    target: ArrayLike | None = None,
    within: float = WITHIN,
) -> Survey:
    """What searches say of the landscape of their problem.

    Parameters
    ----------
    problem
        That of the searches.
    searches
        From `identknee.identify.sweep.sweep.sweep`.
    target
        The truth where it is known, shape ``(p,)``; the lowest polished end if None.
    within
        How close an end has to be, as `identknee.identify.distance` counts: in kN and %.
    """
    basins = find_basins(problem, searches)
    middle = _target(searches, target)
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


def _target(searches: Searches, target: ArrayLike | None) -> Array | None:
    if target is not None:
        return frozen(target, searches.parameters.n, name="the target")
    best = searches.best
    return searches.polished[best] if np.isfinite(searches.polished_objectives[best]) else None
