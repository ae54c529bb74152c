"""What a sweep says of the landscape: its basins, what is unseen, and how close to start."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.problem import Problem
from identknee.identify.sweep.basins import Basins, find_basins
from identknee.identify.sweep.recovery import Radius, Recovery, is_recovered, radius, recovery
from identknee.identify.sweep.starts_design import distance
from identknee.identify.sweep.sweep import Sweep
from identknee.identify.sweep.unseen import Unseen, unseen_mass
from identknee.runs.arrays import Array, frozen

END, POLISHED = "end", "polished"
WITHIN = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """A sweep and what is read from it.

    Attributes
    ----------
    sweep
        The searches.
    basins, unseen
        What the polished ends gather to, and how much no start has shown.
    target
        Truth, or the lowest polished end, shape ``(p,)``; None where no search had a prediction.
    within
        How close to the target an end has to be to have recovered it, in kN and %.
    recoveries, radii
        How often that happens by the distance of the start, and how close a start must be for it
        to happen nine times of ten: of the optimizer's own ``"end"`` and of the ``"polished"`` one.
        Empty without a target.
    """

    sweep: Sweep
    basins: Basins
    unseen: Unseen
    target: Array | None
    within: float
    recoveries: Mapping[str, Recovery]
    radii: Mapping[str, Radius]


def survey(
    problem: Problem,
    sweep: Sweep,
    *,
    target: ArrayLike | None = None,
    within: float = WITHIN,
) -> Survey:
    """What a sweep says of the landscape of its problem.

    Parameters
    ----------
    problem
        That of the sweep.
    sweep
        From `identknee.sweep`.
    target
        The truth where it is known, shape ``(p,)``; the lowest polished end if None.
    within
        How close an end has to be, as `identknee.distance` counts: in kN and %.
    """
    basins = find_basins(problem, sweep)
    middle = _target(sweep, target)
    recoveries: dict[str, Recovery] = {}
    radii: dict[str, Radius] = {}
    if middle is not None:
        away = distance(sweep.starts, middle, sweep.parameters)
        for name in (END, POLISHED):
            is_back = is_recovered(sweep, middle, within=within, polished=name == POLISHED)
            recoveries[name] = recovery(away, is_back)
            radii[name] = radius(recoveries[name])
    return Survey(
        sweep=sweep,
        basins=basins,
        unseen=unseen_mass(basins.labels),
        target=middle,
        within=within,
        recoveries=MappingProxyType(recoveries),
        radii=MappingProxyType(radii),
    )


def _target(sweep: Sweep, target: ArrayLike | None) -> Array | None:
    if target is not None:
        return frozen(target, sweep.parameters.n, name="the target")
    best = sweep.best
    return sweep.polished[best] if np.isfinite(sweep.polished_objectives[best]) else None
