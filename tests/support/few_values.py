"""Data sets of 4 to 20 measured values, their profiles, and what the ends of these hang on."""

from typing import Any

import numpy as np
from knees import knee

from identknee.calibrate.problem import BoundedProblem, ParameterQuantity
from identknee.identify.optimum import best_fit
from identknee.identify.profile.profile import profile_quantities
from identknee.identify.profile.result import Profile, ProfileVerdict
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


def few_values(name: str, seed: int) -> LaxityResiduals:
    """A problem of 4 to 20 values drawn from seeded trials of seed63."""
    generator = np.random.default_rng((34, seed))
    n = int(generator.integers(FEWEST, MOST + 1))
    protocol = load_protocol("seed63")
    trials = generator.choice(len(protocol.trials), size=-(-n // 2), replace=False)
    model = LaxityModel(knee=knee(name), protocol=protocol.select(np.sort(trials).tolist()))
    noisy = add_noise(
        model.simulate(model.parameters.center), sd_mm=NOISE, sd_deg=NOISE, seed=np.random.SeedSequence((34, seed, 1))
    )
    # Two or three coordinates a trial, so many values in all.
    cells = np.argwhere(noisy.is_measured)
    kept = generator.choice(len(cells), size=n, replace=False)
    blank = np.ones(noisy.coordinates.shape, bool)
    blank[tuple(cells[kept].T)] = False
    coordinates = np.where(blank, np.nan, noisy.coordinates)
    sd = np.where(blank, np.nan, noisy.sd)
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
    """Ends and verdicts of all parameters, and how far the ends move with every bound doubled.

    The oracle knows nothing of how an end is tested: it fits and profiles all over again in the
    wider box.
    """
    name, seed = task
    problem = few_values(name, seed)
    found = _profiles(problem)
    wide = _profiles(BoundedProblem(problem=problem, parameters=doubled(problem.parameters)))
    return {
        "n_values": int(problem.laxity.is_measured.sum()),
        "parameters": [x.name for x in found],
        "verdicts": [x.verdict.value for x in found],
        "ends": [(x.lower, x.upper) for x in found],
        "origins": [(x.lower_origin, x.upper_origin) for x in found],
        "wide_ends": [(x.lower, x.upper) for x in wide],
        "moves": [_moves(x, y) for x, y in zip(found, wide, strict=True)],
        "n_simulations": [x.n_simulations for x in found],
    }


def _profiles(problem: Any) -> tuple[Profile, ...]:
    parameters = problem.parameters
    quantities = [ParameterQuantity(parameters=parameters, name=x) for x in parameters.names]
    return profile_quantities(problem, best_fit(problem).theta, quantities)


def _moves(found: Profile, wide: Profile) -> tuple[bool, bool]:
    """Whether each closed end moves by more than a tenth of the width of its interval."""
    low, high = found.intervals[0][0], found.intervals[-1][1]
    inner = (found.intervals[0][1], found.intervals[-1][0])
    moved = []
    for end, other, there in zip((low, high), inner, (wide.lower, wide.upper), strict=True):
        if end is None:
            moved.append(False)
            continue
        width = abs(end - (found.optimum_value if other is None else other))
        moved.append(there is None or abs(there - end) > MOVED * width)
    return moved[0], moved[1]


def called_identifiable(verdict: str) -> bool:
    """Whether the data are said to bound a parameter on both sides."""
    return verdict == ProfileVerdict.IDENTIFIABLE.value
