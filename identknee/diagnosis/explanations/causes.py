"""The causes of a fit in physical units: how large each is, and how well that is known."""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtri

from identknee.calibrate.evaluation import Evaluation
from identknee.diagnosis.explanations.refit import Refit
from identknee.diagnosis.normal_in_box import box_intervals, log_box_probability, log_interval_mass
from identknee.model.effects.structures import MissingStructure
from identknee.model.effects.units import PLAIN, unit_of
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray, frozen
from identknee.runs.declare import declared, entry

# Share of a standard deviation that rounding may move an end by.
ROUNDING = 1e-9
TWO_SIDED = float(ndtri(0.975))
TOTAL = "total"


Interval = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Laplace:
    """The posterior near a fit: Gaussian in the coordinates in which the priors are.

    These are the logarithms of parameters with lognormal priors and the others as they are.

    Attributes
    ----------
    theta
        The fit, shape ``(p,)``.
    sd
        Posterior standard deviation of each parameter in its own unit, shape ``(p,)``.
    lower, upper
        Ends of their 95 % intervals, within the bounds, shape ``(p,)``.
    is_lower_open, is_upper_open
        Whether an end is no limit that the data give, shape ``(p,)``: a bound, or the estimate
        itself where the straight model puts the interval beside it.
    log_evidence
        Logarithm of the integral of likelihood times prior within the bounds.
    """

    theta: Array
    sd: Array
    lower: Array
    upper: Array
    is_lower_open: BoolArray
    is_upper_open: BoolArray
    log_evidence: float

    def __post_init__(self) -> None:
        for name in ("theta", "sd", "lower", "upper"):
            object.__setattr__(self, name, frozen(getattr(self, name), None, name=name))

    def interval(self, i: int) -> tuple[float | None, float | None]:
        """Ends of the interval of one parameter; None where the data give none."""
        return (
            None if self.is_lower_open[i] else float(self.lower[i]),
            None if self.is_upper_open[i] else float(self.upper[i]),
        )


def laplace(at: Evaluation, parameters: Parameters, noise_factor: Array) -> Laplace:
    """The posterior around a fit, priors normal or lognormal and cut off at the bounds.

    Exact for a model that is linear in these coordinates, also where a bound holds the fit.

    Parameters
    ----------
    at
        Whitened residuals of the m data, those of the priors after them, and their derivatives.
    parameters
        With bounds and priors.
    noise_factor
        Cholesky factor of the covariance of the data, shape ``(m, m)``.

    References
    ----------
    R. E. Kass and A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90 (1995) 773-795,
    doi:10.1080/01621459.1995.10476572, equation 5.
    """
    is_log = np.array(parameters.is_log)
    scale = np.where(is_log, at.theta, 1.0)
    point, center, lower, upper = (
        _logs(x, is_log) for x in (at.theta, parameters.center, parameters.lower, parameters.upper)
    )
    jacobian = at.jacobian * scale
    information = cho_factor(jacobian.T @ jacobian, lower=True)
    covariance = cho_solve(information, np.eye(point.size))
    gradient = jacobian.T @ at.residuals
    middle = point - covariance @ gradient
    prior_mass = log_interval_mass(
        (lower - center) / parameters.prior_sd, (upper - center) / parameters.prior_sd
    )
    m = len(noise_factor)
    log_evidence = (
        -0.5 * (at.deviance - gradient @ covariance @ gradient + m * np.log(2.0 * np.pi))
        - np.log(np.diag(noise_factor)).sum()
        - np.log(parameters.prior_sd).sum()
        - prior_mass.sum()
        - np.log(np.diag(information[0])).sum()
        + log_box_probability(middle, covariance, lower, upper)
    )
    sd = np.sqrt(np.diag(covariance))
    found = box_intervals(middle, covariance, lower, upper)
    # A fit stopped before its minimum is not where the straight model puts the parameters, and
    # neither end of such an interval is known.
    slack = ROUNDING * sd
    is_beside = (found.lower > point + slack) | (found.upper < point - slack)
    low, high = (
        np.where(is_log, np.exp(np.where(is_log, x, 0.0)), x) for x in (found.lower, found.upper)
    )
    return Laplace(
        theta=at.theta,
        sd=scale * sd,
        lower=np.minimum(low, at.theta),
        upper=np.maximum(high, at.theta),
        is_lower_open=found.is_lower_bound | is_beside,
        is_upper_open=found.is_upper_bound | is_beside,
        log_evidence=float(log_evidence),
    )


def _logs(values: Array, is_log: BoolArray) -> Array:
    """The logarithms where the prior is lognormal."""
    with np.errstate(divide="ignore"):
        return np.where(is_log, np.log(np.where(is_log, values, 1.0)), values)


@declared
class Estimate:
    """A number found by a fit."""

    name: str = entry(
        "Name of the parameter, without its owner; total for the length of a vector of several"
    )
    value: float = entry("Its value", unit="as the field unit says")
    unit: str = entry("Its unit; 1 for a plain number")
    ci95: Interval = entry(
        "95 % interval; null where the data give no limit: at a bound, or where the fit that it "
        "is the interval of was stopped",
        unit="as the field unit says",
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cause:
    """A cause and its amplitudes.

    Attributes
    ----------
    name
        As in the library.
    amplitude
        The one number that says how large it is.
    parameters
        All of its amplitudes.
    line
        Femoral and tibial end in the common frame of the scanned pose [mm], shape ``(2, 3)``; None
        for what is not one line.
    """

    name: str
    amplitude: Estimate
    parameters: tuple[Estimate, ...]
    line: Array | None


def posterior_of(refit: Refit) -> Laplace:
    """Intervals of all parameters of a fit."""
    fitted = refit.fitted
    return laplace(fitted.evaluation, fitted.model.parameters, fitted.noise.factor)


def causes_of(refit: Refit) -> tuple[Cause, ...]:
    """The causes that a fit has beyond the base model, with their amplitudes.

    For amplitudes in one unit that may have either sign, such as the components of a force, the
    total counts: the root of the sum of their squares, less what their errors add to it. Of others
    in the unit of the first, such as the stiffnesses of two halves, the largest counts.
    """
    posterior, covariance = posterior_of(refit), refit.covariance()
    return tuple(_cause(refit, x, posterior, covariance) for x in refit.names)


def ligament_estimates(refit: Refit) -> dict[str, dict[str, Estimate]]:
    """The calibrated parameters of a fit by ligament and quantity."""
    posterior = posterior_of(refit)
    n = refit.fitted.model.n_ligament_parameters
    tree: dict[str, dict[str, Estimate]] = {}
    for i, name in enumerate(refit.fitted.model.parameters.names[:n]):
        found = _estimate(name, i, posterior)
        tree.setdefault(name.rpartition(".")[0], {})[found.name] = found
    return tree


def _cause(refit: Refit, name: str, posterior: Laplace, covariance: np.ndarray) -> Cause:
    parameters, places = refit.fitted.model.parameters, refit.places(name)
    found = tuple(_estimate(parameters.names[i], int(i), posterior) for i in places)
    unit = found[0].unit
    # Plain numbers are not alike for having no unit.
    same = [k for k, x in enumerate(found) if k == 0 or x.unit == unit != PLAIN]
    if len(same) == len(found) > 1 and np.all(parameters.lower[places] < 0.0):
        amplitude = _total(found, covariance[np.ix_(places, places)], parameters.prior_sd[places])
    else:
        amplitude = reduce(lambda x, y: y if y.value > x.value else x, [found[k] for k in same])
    return Cause(name=name, amplitude=amplitude, parameters=found, line=_line(refit, name))


def _line(refit: Refit, name: str) -> Array | None:
    """Where the line of a structure runs with the shifts found."""
    knee = refit.fitted.model.knee
    effect = next(x for x in refit.causes if x.name == name)
    if not isinstance(effect, MissingStructure) or len(effect.femoral) > 1:
        return None
    femoral, tibial = effect.insertions(refit.amplitudes(name))
    return np.vstack([knee.femur_frame.to_common(femoral), knee.tibia_frame.to_common(tibial)])


def _total(
    components: tuple[Estimate, ...], covariance: np.ndarray, prior_sd: np.ndarray
) -> Estimate:
    """Length of a vector, its interval to first order, the lower end by what errors add to it.

    Errors of the components make the length found too long: its square is expected to be that of
    the true length and the sum of the variances that noise alone gives them.
    """
    values = np.array([x.value for x in components])
    square = float(values @ values)
    along = float(values @ covariance @ values) / square if square > 0.0 else 0.0
    # What the prior adds to the uncertainty does not scatter the values found.
    scatter = covariance - covariance @ np.diag(prior_sd**-2.0) @ covariance
    middle = max(square - float(np.trace(scatter)), 0.0)
    reach = TWO_SIDED * np.sqrt(along)
    low, high = max(np.sqrt(middle) - reach, 0.0), np.sqrt(square) + reach
    # A component without a limit leaves the length without one.
    is_open = any(None in x.ci95 for x in components)
    is_unknown = any(x.ci95 == (None, None) for x in components)
    return Estimate(
        name=TOTAL,
        value=float(np.sqrt(middle)),
        unit=components[0].unit,
        ci95=(None if is_unknown else float(low), None if is_open else float(high)),
    )


def _estimate(name: str, i: int, posterior: Laplace) -> Estimate:
    return Estimate(
        name=name.rpartition(".")[2],
        value=float(posterior.theta[i]),
        unit=unit_of(name),
        ci95=posterior.interval(i),
    )
