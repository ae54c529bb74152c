"""Data sets of 4 to 20 measured values, their profiles, and what the ends of these hang on."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from knees import knee

from identknee.calibrate.bounded_least_squares import minimise
from identknee.calibrate.problem import BoundedProblem, Evaluator, ParameterQuantity, Problem
from identknee.identify.profile.profile import UNDECIDED, profile_quantities
from identknee.identify.profile.result import Profile, Side
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, add_noise
from identknee.model.laxity_model import LaxityModel
from identknee.model.parameters import Parameters
from identknee.model.residuals import LaxityResiduals

KNEES = ("reference", "lenhart2015_stable")
NOISE = 0.5  # mm and deg
FEWEST, MOST = 4, 20
# Of the width of an interval: an end that moves by more with other bounds hangs on them.
MOVED = 0.1
# Simulations of a profile, of which many have no end to find with so few values, and of the oracle.
BUDGET, ORACLE_BUDGET = 300, 1000


def few_values(name: str, seed: int) -> LaxityResiduals:
    """A problem of 4 to 20 values drawn from seeded trials of seed63."""
    generator = np.random.default_rng((34, seed))
    n = int(generator.integers(FEWEST, MOST + 1))
    protocol = load_protocol("seed63")
    trials = generator.choice(len(protocol.trials), size=-(-n // 2), replace=False)
    model = LaxityModel(knee=knee(name), protocol=protocol.select(np.sort(trials).tolist()))
    simulated = model.simulate(model.parameters.center)
    noise = np.random.SeedSequence((34, seed, 1))
    noisy = add_noise(simulated, sd_mm=NOISE, sd_deg=NOISE, seed=noise)
    # Two or three coordinates a trial, so many values in all.
    cells = np.argwhere(noisy.is_measured)
    kept = generator.choice(len(cells), size=n, replace=False)
    blank = np.ones(noisy.coordinates.shape, bool)
    blank[tuple(cells[kept].T)] = False
    coordinates = np.where(blank, np.nan, noisy.coordinates)
    sd = np.where(blank, np.nan, NOISE)
    measured = np.flatnonzero(~blank.all(axis=1)).tolist()
    laxity = Laxity(protocol=noisy.protocol, coordinates=coordinates, sd=sd).select(measured)
    return LaxityResiduals(
        model=model.with_protocol(laxity.protocol), laxity=laxity, weighting="noise"
    )


def doubled(parameters: Parameters) -> Parameters:
    """The parameters with bounds twice as far out: stiffnesses to 80 kN, strains to 30 %."""
    return parameters.with_bounds(
        {
            name: (2.0 * low, 2.0 * high)
            for name, low, high in zip(
                parameters.names, parameters.lower.tolist(), parameters.upper.tolist(), strict=True
            )
        }
    )


def ends_of_data_set(task: tuple[str, int]) -> dict[str, Any]:
    """Origins of all closed ends; of sets closed on both sides, whether every bound doubled moves.

    The oracle knows nothing of how an end is tested: it fits and profiles all over again in the
    wider box.
    """
    problem = few_values(*task)
    found = profiles_of(problem, problem.parameters.names, budget=BUDGET)
    closed = [x.name for x in found if x.lower is not None and x.upper is not None]
    wide = {x.name: x for x in profiles_of(wider(problem), closed, budget=ORACLE_BUDGET)}
    ends = []
    for x in found:
        moved = moves(x, wide[x.name]) if x.name in wide else (None, None)
        for side, own in zip((x.lower_side, x.upper_side), moved, strict=True):
            if side.end is None:
                continue
            ends.append(
                {
                    "parameter": x.name,
                    "verdict": x.verdict.value,
                    "set": (x.lower, x.upper),
                    "end": side.end,
                    "made_by": None if side.made_by is None else side.made_by.value,
                    "bound_of": side.bound_of,
                    "wide": (wide[x.name].lower, wide[x.name].upper) if x.name in wide else None,
                    "moves": own,
                }
            )
    return {
        "n_values": int(problem.laxity.is_measured.sum()),
        "ends": ends,
        "n_simulations": [x.n_simulations for x in found],
    }


def wider(problem: Problem) -> BoundedProblem:
    """The problem with every bound doubled."""
    return BoundedProblem(problem=problem, parameters=doubled(problem.parameters))


def profiles_of(
    problem: Problem, names: Sequence[str], *, budget: int, looks_around: bool = True
) -> tuple[Profile, ...]:
    """Profiles from the optimum nearest to the subject's values, with other optima or without.

    Fits of more parameters than values creep for thousands of simulations; what they would find is
    among the other optima, and a profile that meets a better one starts over.
    """
    quantities = [ParameterQuantity(parameters=problem.parameters, name=x) for x in names]
    nearest = minimise(Evaluator(problem), problem.parameters.center).evaluation.theta
    starts = None if looks_around else ()
    return profile_quantities(problem, nearest, quantities, budget=budget, starts=starts)


def moves(found: Profile, wide: Profile) -> tuple[bool | None, bool | None]:
    """Whether the ends of a set move by more than a tenth of its width, or are none any more.

    None where the set has no such end, or the wider profile did not finish there.
    """
    sides = ((found.lower_side, wide.lower_side), (found.upper_side, wide.upper_side))
    low, high = sides[0][0].end, sides[1][0].end
    width = np.inf if low is None or high is None else high - low
    return _moves(*sides[0], width), _moves(*sides[1], width)


def _moves(own: Side, there: Side, width: float) -> bool | None:
    if own.end is None or there.status in UNDECIDED:
        return None
    return there.end is None or abs(there.end - own.end) > MOVED * width
