"""Where a global sensitivity analysis simulates: a box of parameters and the designs in it."""

import numpy as np

from identknee.calibrate.scales import by_unit
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import OF_PARAMETER, array, declared

STIFFNESS_SHARE, STRAIN_PCT, PRIOR_SDS = 0.5, 3.0, 1.5
# An even number of levels and steps over half of them: every level is met equally often.
MORRIS_LEVELS = 4


@declared
class Box:
    """A range for every parameter, each value in it as likely as any other.

    Raises
    ------
    ValueError
        If a range is empty or not finite.
    """

    lower: Array = array("Lower ends", "parameter", unit=OF_PARAMETER, is_in_json=True)
    upper: Array = array("Upper ends", "parameter", unit=OF_PARAMETER, is_in_json=True)

    def __post_init__(self) -> None:
        width = self.upper - self.lower
        if not np.all(np.isfinite(width) & (width > 0)):
            worst = int(np.flatnonzero(~(np.isfinite(width) & (width > 0)))[0])
            raise ValueError(
                f"the range of parameter {worst + 1} is {self.lower[worst]:g} to "
                f"{self.upper[worst]:g}: its lower end must be below its upper end, both finite"
            )

    @property
    def n(self) -> int:
        """How many parameters there are."""
        return int(self.lower.size)

    def scaled(self, unit: Array) -> Array:
        """Points of the box from points of the unit cube, shape ``(..., n)``."""
        return np.asarray(self.lower + unit * (self.upper - self.lower))


def box_around(parameters: Parameters, center: Array) -> Box:
    """The usual box: stiffness +-50 %, reference strain +-3 %, other parameters +-1.5 prior sd.

    Parameters
    ----------
    parameters
        For names, bounds and priors; the box stays within the bounds.
    center
        Its middle, shape ``(n,)``.
    """
    sd = np.where(parameters.is_log, parameters.prior_sd * np.abs(center), parameters.prior_sd)
    reach = by_unit(parameters, STIFFNESS_SHARE * np.abs(center), STRAIN_PCT, PRIOR_SDS * sd)
    return Box(
        lower=np.maximum(center - reach, parameters.lower),
        upper=np.minimum(center + reach, parameters.upper),
    )


def saltelli_blocks(box: Box, n: int, seed: int) -> Array:
    """Blocks of a scrambled Saltelli design, shape ``(n, p + 2, p)``.

    A block is a point A, then p points with one coordinate each taken from a second point B, then
    B itself. The first blocks stay the same when n grows, so that more can be added.

    Parameters
    ----------
    box
        Where, with p parameters.
    n
        Number of blocks, a power of 2.
    seed
        Seed of the scrambling.

    Raises
    ------
    ValueError
        If n is not a power of 2: the sequence is balanced only there.

    References
    ----------
    A. Saltelli et al., Computer Physics Communications 181 (2010) 259-270,
    doi:10.1016/j.cpc.2009.09.018.
    """
    if n < 2 or n & (n - 1):
        near = 2 ** max(1, round(np.log2(max(n, 2))))
        raise ValueError(f"Sobol indices need a power of 2 of blocks, got {n}; ask for {near}")
    # SALib loads pandas, which takes longer than many an analysis.
    from SALib.sample import sobol

    points = sobol.sample(_cube(box.n), n, calc_second_order=False, seed=seed)
    return box.scaled(points.reshape(n, box.n + 2, box.n))


def morris_trajectories(box: Box, n: int, seed: int) -> Array:
    """Trajectories that change one parameter after the other, shape ``(n, p + 1, p)``.

    Parameters
    ----------
    box
        Where, with p parameters.
    n
        Number of trajectories, at least 2.
    seed
        Seed of their starts and orders.

    Raises
    ------
    ValueError
        If there are fewer than 2, which have no spread.

    References
    ----------
    M. D. Morris, Technometrics 33 (1991) 161-174, doi:10.1080/00401706.1991.10484804.
    """
    if n < 2:
        raise ValueError(f"elementary effects need at least 2 trajectories, got {n}")
    from SALib.sample import morris

    points = morris.sample(_cube(box.n), n, num_levels=MORRIS_LEVELS, seed=seed)
    return box.scaled(points.reshape(n, box.n + 1, box.n))


def box_draws(box: Box, n: int, seed: int) -> Array:
    """Independent draws from the box, shape ``(n, p)``; the first stay the same when n grows."""
    return box.scaled(np.random.default_rng(seed).random((n, box.n)))


def _cube(n: int) -> dict[str, object]:
    """A fresh description each time, because SALib writes into the one it is given."""
    return {
        "num_vars": n,
        "names": [f"x{i}" for i in range(n)],
        "bounds": [[0.0, 1.0] for _ in range(n)],
    }
