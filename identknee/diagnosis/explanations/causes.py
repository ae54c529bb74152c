"""The causes of a fit in physical units: how large each is, and how well that is known."""

from functools import reduce

import numpy as np
from scipy.special import ndtri

from identknee.diagnosis.explanations.refit import Refit
from identknee.identify.laplace import Interval, Laplace, laplace
from identknee.model.effects.structures import MissingStructure
from identknee.model.effects.units import PLAIN, unit_of
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry

TWO_SIDED = float(ndtri(0.975))
TOTAL = "total"


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


@declared
class Cause:
    """A cause and its amplitudes."""

    name: str = entry("As in the library")
    amplitude: Estimate = entry("The one number that says how large it is")
    parameters: tuple[Estimate, ...] = entry("All of its amplitudes")
    line: Array | None = entry(
        "Femoral and tibial end in the common frame of the scanned pose [mm], shape ``(2, 3)``; "
        "None for what is not one line"
    )


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
