"""Parameter sets that a measurement could not tell apart, and what follows wrongly from them."""

from collections.abc import Mapping, Sequence
from enum import Enum, unique

import numpy as np
from scipy.spatial.distance import pdist

from identknee.calibrate.quantity import ParameterQuantity, Quantity
from identknee.identify.equivalents.rays import farthest_first
from identknee.identify.equivalents.region import Region
from identknee.identify.equivalents.search import Extremum, Searches
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_PARAMETER, OF_QUANTITY, array, declared, derived, entry
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
    Completeness.COMPLETE: "All the sets asked for were found.",
    Completeness.FEWER: "The region holds fewer sets that differ enough than were asked for.",
}


@declared
class Extrema:
    """What could be concluded wrongly about one quantity: its range over a region."""

    name: str = entry("Name of the quantity")
    unit: str = entry("Unit of the quantity")
    at_fit: float = entry("Value at the fit", unit=OF_QUANTITY, key="fit")
    lower: Extremum = entry("What was found of the smallest value", key="lower_side")
    upper: Extremum = entry("What was found of the largest value", key="upper_side")

    @property
    @derived("Smallest value over the region", unit=OF_QUANTITY, key="lower")
    def smallest(self) -> float:
        """The smallest value."""
        return self.lower.value

    @property
    @derived("Largest value over the region", unit=OF_QUANTITY, key="upper")
    def largest(self) -> float:
        """The largest value."""
        return self.upper.value


@declared
class EquivalentSets:
    """Parameter sets equivalent to a fit, as different from one another as they come."""

    outcome: Completeness = entry("Whether there are as many sets as asked for")
    limit: float = entry("Largest value of a block", unit="1")
    blocks: tuple[str, ...] = array("Names of the blocks", "block", is_in_arrays=False)
    parameter_names: tuple[str, ...] = array(
        "Names of the parameters", "parameter", is_in_arrays=False
    )
    parameters: Mapping[str, Extrema] = entry(
        "Range of each parameter by its name", rows="ranged_parameter", group="parameter_ranges"
    )
    quantities: Mapping[str, Extrema] = entry(
        "Range of each other quantity by its name", rows="quantity", group="quantity_ranges"
    )
    diameter: float = entry(
        "Largest distance of two points of the region, by constrained maximisation",
        unit="typical steps",
    )
    n_simulations: int = entry("Simulations made, each with its Jacobian", unit="1")
    seed: int = entry("Seed of the random rays", unit="1")
    fit: Array = array("Theta of the fit", "parameter", unit=OF_PARAMETER)
    sets: Array = array(
        "Theta of each set, in the order chosen: the two farthest apart, then always the one "
        "farthest from all before it",
        *("set", "parameter"),
        unit=OF_PARAMETER,
        key="theta",
    )
    distances: Array = array(
        "Value of every block at every set, simulated", "set", "block", key="distance"
    )
    quantity_values: Array = array(
        "Value of every quantity but the parameters at every set",
        *("set", "quantity"),
        unit=OF_QUANTITY,
    )
    steps: Array = array(
        "Typical step of each parameter, in which distances between sets are counted: 3 kN, 2 % or "
        "the prior's sd",
        "parameter",
        unit=OF_PARAMETER,
        key="step",
    )
    pair: Array = array(
        "The two points that far apart",
        *("member", "parameter"),
        unit=OF_PARAMETER,
        key="farthest_pair",
    )
    pair_searches: Array = array(
        "Distances at which the searches for them ended, from the largest down",
        "search",
        unit="typical steps",
        key="pair_search",
    )

    @property
    def extrema(self) -> tuple[Extrema, ...]:
        """All ranges, those of parameters first."""
        return (*self.parameters.values(), *self.quantities.values())

    @property
    @derived("What the outcome means")
    def sentence(self) -> str:
        """What the outcome means, as a full sentence."""
        return self.outcome.sentence

    @property
    @derived("Parameter sets found", unit="1")
    def n_sets(self) -> int:
        """Number of sets."""
        return len(self.sets)

    @property
    @derived("Largest value of a block at any set", unit="1")
    def largest_distance(self) -> float:
        """The largest value of a block at any set."""
        return float(self.distances.max())

    @property
    @derived("Largest distance of two sets", unit="typical steps")
    def farthest(self) -> float:
        """The largest distance of two sets, in typical steps."""
        return float(pdist(self.sets / self.steps).max())

    @property
    @derived("Smallest distance of two sets", unit="typical steps")
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
) -> EquivalentSets:
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
        Seed of the random rays.
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
    return EquivalentSets(
        parameter_names=parameters.names,
        parameters=_extrema(searches, own, at_fit[0]),
        quantities=_extrema(searches, quantities, at_fit[0], parameters.n),
        fit=region.center,
        limit=region.limit,
        blocks=tuple(region.blocks),
        sets=chosen,
        distances=blocks,
        quantity_values=values[:, parameters.n :],
        steps=searches.steps,
        diameter=diameter,
        pair=pair,
        pair_searches=searches.pair_distances,
        outcome=Completeness.COMPLETE if len(chosen) == n_sets else Completeness.FEWER,
        n_simulations=searches.n_simulations,
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
    searches: Searches, quantities: Sequence[Quantity], at_fit: Array, first: int = 0
) -> dict[str, Extrema]:
    """Ranges by name of quantities that stand together among those searched."""
    return {
        quantity.name: Extrema(
            name=quantity.name,
            unit=quantity.unit,
            at_fit=float(at_fit[i]),
            lower=searches.side(i, -1.0),
            upper=searches.side(i, 1.0),
        )
        for i, quantity in enumerate(quantities, first)
    }
