"""Parameter sets that a measurement could not tell apart, and what follows wrongly from them."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, unique

import numpy as np
from scipy.spatial.distance import pdist

from identknee.calibrate.quantity import ParameterQuantity, Quantity
from identknee.identify.equivalents.rays import farthest_first
from identknee.identify.equivalents.region import Region
from identknee.identify.equivalents.search import Searches, Side
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.executors import Executor, serial, spawn_seeds
from identknee.runs.store import Store

# No two sets closer than this part of the diameter.
SEPARATION = 0.02
RAYS_PER_SET, MOST_ROUNDS = 2, 3


@unique
class Completeness(Enum):
    """Whether as many sets were found as asked for; the value is the word written to files."""

    COMPLETE = "complete"
    FEWER = "fewer"

    @property
    def sentence(self) -> str:
        """What happened, as a full sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    Completeness.COMPLETE: "As many different sets were found as asked for.",
    Completeness.FEWER: "The region was found to hold fewer sets as different as asked for.",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Extrema:
    """What could be concluded wrongly about one quantity.

    Attributes
    ----------
    name, unit
        Of the quantity.
    at_fit
        Its value at the fit.
    lower, upper
        Its smallest and largest value over the region.
    """

    name: str
    unit: str
    at_fit: float
    lower: Side
    upper: Side


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equivalents:
    """Parameter sets equivalent to a fit, as different from one another as they come.

    Attributes
    ----------
    parameters
        The parameters.
    fit
        Theta of the fit, shape ``(n,)``.
    limit, blocks
        The largest value of a block, and the blocks' names.
    sets
        Theta of each set, shape ``(n_sets, n)``, in the order chosen: the two farthest apart, then
        always the one farthest from all before it.
    distances
        Value of every block at every set, simulated, shape ``(n_sets, n_blocks)``.
    quantities
        Value of every quantity but the parameters at every set, shape ``(n_sets, n_quantities)``.
    steps
        What distances between sets are counted in: typical steps, 3 kN, 2 % or the prior's sd,
        shape ``(n,)``.
    diameter
        The largest distance of two points of the region, by constrained maximisation.
    pair
        These two points, shape ``(2, n)``.
    pair_searches
        Where the searches for it ended, from the largest down, shape ``(n_searches,)``.
    extrema
        Of every parameter, then of every other quantity.
    outcome
        Whether there are as many sets as asked for.
    n_simulations, seconds
        Simulations made, and time taken by this run [s].
    seed
        Of the random rays.
    """

    parameters: Parameters
    fit: Array
    limit: float
    blocks: tuple[str, ...]
    sets: Array
    distances: Array
    quantities: Array
    steps: Array
    diameter: float
    pair: Array
    pair_searches: Array
    extrema: tuple[Extrema, ...]
    outcome: Completeness
    n_simulations: int
    seconds: float
    seed: int

    def __post_init__(self) -> None:
        n, n_sets = self.parameters.n, len(self.sets)
        shapes: Mapping[str, tuple[int | None, ...]] = {
            "fit": (n,),
            "sets": (n_sets, n),
            "distances": (n_sets, len(self.blocks)),
            "quantities": (n_sets, len(self.extrema) - n),
            "steps": (n,),
            "pair": (2, n),
            "pair_searches": (None,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen(getattr(self, name), *shape, name=name))

    @property
    def farthest(self) -> float:
        """The largest distance of two sets, in typical steps."""
        return float(pdist(self.sets / self.steps).max())

    @property
    def closest(self) -> float:
        """The smallest distance of two sets, in typical steps."""
        return float(pdist(self.sets / self.steps).min())


def equivalents(
    region: Region,
    *,
    quantities: Sequence[Quantity] = (),
    n_sets: int = 100,
    seed: int = 0,
    executor: Executor = serial,
    store: Store | None = None,
) -> Equivalents:
    """Maximally different parameter sets of a region, and the extrema of quantities over it.

    Constrained searches with exact derivatives find the smallest and largest value of every
    parameter and quantity and the two points farthest apart, from several starts each: the fit,
    the axes of the linear model, and the best of the points found along random rays. From all
    these points the sets are chosen farthest first, and simulated once more.

    Parameters
    ----------
    region
        What counts as equivalent; from `noise_region`, or with blocks of one's own.
    quantities
        What to bound beside the parameters, for example ligament forces.
    n_sets
        How many sets, at least 2.
    seed
        Of the random rays.
    executor
        Anything with an ordered ``map``; the result is the same whichever it is.
    store
        Where finished searches are kept, from `identknee.runs.resume.open_work`.

    Raises
    ------
    ValueError
        If fewer than 2 sets are asked for, or the model or a quantity has no prediction at the fit.
    """
    if n_sets < 2:
        raise ValueError(f"the number of sets must be at least 2, got {n_sets}")
    began = time.perf_counter()
    parameters = region.problem.parameters
    own = [ParameterQuantity(parameters=parameters, name=name) for name in parameters.names]
    searches = Searches(region, [*own, *quantities], executor, store)
    everything = range(len(own) + len(quantities))
    fit = searches.pool
    at_fit = searches.measured(fit, "fit")[1]
    for quantity, value in zip(quantities, at_fit[0, parameters.n :], strict=True):
        if not np.isfinite(value):
            raise ValueError(f"{quantity.name} has no prediction at the fit; leave it out")
    searches.extremes(range(parameters.n), fit, at_fit, "first extrema")
    searches.pairs(searches.axis_pairs() + searches.far_pairs(), "first pairs")
    chosen = origins = fit
    for number, round_seed in enumerate(spawn_seeds(seed, MOST_ROUNDS)):
        searches.rays(origins, RAYS_PER_SET * n_sets, round_seed, f"rays {number}")
        starts = np.vstack([fit, _spread(searches, n_sets)])
        values = searches.measured(starts, f"starts {number}")[1]
        which = searches.doubtful() if number else everything
        searches.extremes(which, starts, values, f"extrema {number}")
        searches.pairs(searches.far_pairs(), f"pairs {number}")
        chosen, origins = _spread(searches, n_sets), searches.pool
        if number and len(chosen) == n_sets:
            break
    blocks, values = searches.measured(chosen, "sets")
    diameter, pair = searches.farthest_pair
    return Equivalents(
        parameters=parameters,
        fit=region.center,
        limit=region.limit,
        blocks=tuple(region.blocks),
        sets=chosen,
        distances=blocks,
        quantities=values[:, parameters.n :],
        steps=searches.steps,
        diameter=diameter,
        pair=pair,
        pair_searches=searches.pair_distances,
        extrema=_extrema(searches, [*own, *quantities], at_fit[0]),
        outcome=Completeness.COMPLETE if len(chosen) == n_sets else Completeness.FEWER,
        n_simulations=searches.n_simulations,
        seconds=time.perf_counter() - began,
        seed=seed,
    )


def _spread(searches: Searches, n: int) -> Array:
    """Points of the pool far from one another, the farthest pair first, shape ``(<= n, p)``."""
    diameter, pair = searches.farthest_pair
    points = np.vstack([pair, searches.pool])
    ends = np.arange(2)
    chosen = farthest_first(points / searches.steps, ends, n, SEPARATION * diameter)
    return np.asarray(points[chosen])


def _extrema(
    searches: Searches, quantities: Sequence[Quantity], at_fit: Array
) -> tuple[Extrema, ...]:
    return tuple(
        Extrema(
            name=quantity.name,
            unit=quantity.unit,
            at_fit=float(at_fit[i]),
            lower=searches.side(i, -1.0),
            upper=searches.side(i, 1.0),
        )
        for i, quantity in enumerate(quantities)
    )
