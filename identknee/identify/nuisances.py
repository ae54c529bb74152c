"""Nuisance parameters at the fit: estimates relative to their priors."""

import numpy as np

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.problem import Problem
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry

# Share of its prior variance that the data must take from a combination of nuisances to speak of
# it: what they hardly see has no scatter of its own.
LEAST_SEEN = 1e-6
OF_NUISANCE = "mm, deg or a plain number, as its name says"


@declared
class NuisanceEstimate:
    """A nuisance at the best fit."""

    name: str = entry("Name of the nuisance, whose last word is the unit")
    value: float = entry("Value at the best fit", unit=OF_NUISANCE)
    sd: float = entry(
        "Standard deviation that data and prior leave, to first order", unit=OF_NUISANCE
    )
    prior_sd: float = entry("Standard deviation of the prior", unit=OF_NUISANCE)
    center: float = entry("Middle of the prior", unit=OF_NUISANCE)

    @property
    def scatter(self) -> float:
        """Standard deviation of the estimate; near zero if the data hardly depend on it."""
        return float(np.sqrt(max(self.prior_sd**2 - self.sd**2, 0.0)))

    @property
    def away(self) -> float:
        """Distance from the prior mean in prior standard deviations."""
        return (self.value - self.center) / self.prior_sd


@declared
class NuisanceGroup:
    """Nuisances of one kind and place together."""

    name: str = entry("What they have in common, such as insertion.ACL_femur")
    n: int = entry("How many there are", unit="1")
    p_value: float = entry("Probability that errors with the stated prior lie so far out", unit="1")


def nuisance_estimates(problem: Problem, theta: Array) -> tuple[NuisanceEstimate, ...]:
    """The nuisances of a problem at its best fit, in the order of theta; empty without any.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise, with rows for the priors of nuisances.
    theta
        The best fit, shape ``(n,)``.
    """
    p = problem.parameters
    places = np.flatnonzero(~p.is_of_interest)
    if not places.size:
        return ()
    sds = np.sqrt(np.diag(_covariance(problem, theta)))
    return tuple(
        NuisanceEstimate(
            name=p.names[i],
            value=float(theta[i]),
            sd=float(min(sds[i], p.prior_sd[i])),
            prior_sd=float(p.prior_sd[i]),
            center=float(p.center[i]),
        )
        for i in places
    )


def nuisance_groups(problem: Problem, theta: Array) -> tuple[NuisanceGroup, ...]:
    """How improbable the nuisances of each kind and place are under their prior.

    Estimates scatter by what the data have taken from the variance of the prior. Parameters as in
    `nuisance_estimates`.
    """
    # Loaded late: it takes longer than a simulation.
    from scipy.special import chdtrc

    p = problem.parameters
    covariance = _covariance(problem, theta)
    made = []
    for name, places in nuisance_places(p).items():
        sd = p.prior_sd[places]
        away = (theta[places] - p.center[places]) / sd
        scatter = np.eye(len(places)) - covariance[np.ix_(places, places)] / np.outer(sd, sd)
        size, directions = np.linalg.eigh(scatter)
        seen = size > LEAST_SEEN
        square = float(np.sum((directions[:, seen].T @ away) ** 2 / size[seen]))
        n = int(seen.sum())
        p_value = float(chdtrc(n, square)) if n else 1.0
        made.append(NuisanceGroup(name=name, n=len(places), p_value=p_value))
    return tuple(made)


def nuisance_places(parameters: Parameters) -> dict[str, list[int]]:
    """Places in theta of the nuisances of each kind and place, by the name of their group."""
    groups: dict[str, list[int]] = {}
    for i in np.flatnonzero(~parameters.is_of_interest).tolist():
        groups.setdefault(group_name(parameters.names[i]), []).append(i)
    return groups


def group_name(name: str) -> str:
    """Kind and place of a nuisance: its name without axis and unit.

    Examples
    --------
    >>> group_name("insertion.ACL_femur_x_mm"), group_name("load_axes.x_deg")
    ('insertion.ACL_femur', 'load_axes')
    """
    kind, _, rest = name.partition(".")
    words = rest.split("_")
    return f"{kind}.{'_'.join(words[:-2])}" if len(words) > 2 else kind


def _covariance(problem: Problem, theta: Array) -> Array:
    """First-order covariance of all parameters, without undetermined directions."""
    jacobian = evaluate(problem, theta).jacobian
    p = problem.parameters
    scaled = jacobian * p.prior_sd_in_own_units
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    return np.asarray(inverse * np.outer(p.prior_sd_in_own_units, p.prior_sd_in_own_units))
