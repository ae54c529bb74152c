"""What an error known twice as well would tell, in the currency in which trials are compared."""

from collections.abc import Mapping

import numpy as np

from identknee.identify.design.criteria import WidthLoss
from identknee.identify.design.predictions import CandidatePredictions
from identknee.identify.nuisances import nuisance_places
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import OF_QUANTITY, array, declared

# Of a stated standard deviation: what is left of it where an error is known better.
SHARE = 0.5


@declared
class Narrowing:
    """What one more trial, or one stated error known twice as well, leaves of each target.

    Widths are predicted along the profiles, as `WidthLoss` says.
    """

    errors: tuple[str, ...] = array(
        "Stated errors that may be known better, such as insertion.ACL_femur",
        "error",
        is_in_arrays=False,
    )
    now: Array = array(
        "Width of each target's interval now, an open end continued in proportion",
        "target",
        unit=OF_QUANTITY,
        key="width_now",
    )
    with_trial: Array = array(
        "Predicted width with one candidate added; NaN for those excluded",
        *("candidate", "target"),
        unit=OF_QUANTITY,
        key="width_with_trial",
    )
    with_error_halved: Array = array(
        "Predicted width with the stated standard deviation of one error halved",
        *("error", "target"),
        unit=OF_QUANTITY,
        key="width_with_error_halved",
    )

    @property
    def by_trial(self) -> Array:
        """Share by which each candidate narrows each target, shape ``(k, t)``; NaN if excluded."""
        return np.asarray(1.0 - self.with_trial / self.now)

    @property
    def by_error(self) -> Array:
        """Share by which each error known better narrows each target, shape ``(e, t)``."""
        return np.asarray(1.0 - self.with_error_halved / self.now)


def narrowing(
    width: WidthLoss,
    features: tuple[Array, Array],
    allowed: BoolArray,
    halved: Mapping[str, Array],
) -> Narrowing:
    """How trials and errors known better narrow the targets, one at a time.

    Parameters
    ----------
    width
        The profiles of the targets.
    features
        Of the trials made, shape ``(f,)``, and of the candidates, ``(k, f)``.
    allowed
        Which candidates are offered, shape ``(k,)``.
    halved
        Features of each error known twice as well, shape ``(1, f)``, by its name.
    """
    made, trials = features
    with_trial = np.full((len(trials), len(width.paths)), np.nan)
    with_trial[allowed] = _widths(width, made + trials[allowed])
    return Narrowing(
        errors=tuple(halved),
        now=_widths(width, made[None])[0],
        with_trial=with_trial,
        with_error_halved=_widths(
            width, made + np.vstack([np.empty((0, made.size)), *halved.values()])
        ),
    )


def errors_halved(
    width: WidthLoss, points: CandidatePredictions, parameters: Parameters
) -> dict[str, Array]:
    """Features of errors that are parameters, their standard deviations halved, ``(1, f)`` each."""
    groups = nuisance_places(parameters)
    return {name: width.of_trials(*_as_trial(points, parameters, x)) for name, x in groups.items()}


def mean_share(shares: Array) -> float:
    """The share by which intervals narrow by the geometric mean of what is left of them.

    Examples
    --------
    >>> round(mean_share(np.array([0.5, 0.0])), 3)
    0.293
    """
    return float(1.0 - np.exp(np.mean(np.log1p(-shares))))


def _widths(width: WidthLoss, features: Array) -> Array:
    """Predicted widths of the targets, shape ``(k, t)``."""
    return np.stack([ends[:, 1] - ends[:, 0] for ends, _ in width.intervals(features)], axis=1)


def _as_trial(
    points: CandidatePredictions, parameters: Parameters, places: list[int]
) -> tuple[Array, Array]:
    """The parameters at `places` measured so well that their priors narrow to `SHARE`.

    Values ``(q, 1, m)`` in units of that measurement's noise, derivatives ``(q, 1, m, n)`` by the
    scaled parameters.
    """
    per_unit = np.sqrt(SHARE**-2 - 1.0) / parameters.prior_sd[places]
    slopes = np.zeros((len(places), parameters.n))
    slopes[np.arange(len(places)), places] = per_unit * points.scales[places]
    values = points.thetas[:, None, places] * per_unit
    return values, np.broadcast_to(slopes, (len(values), 1, *slopes.shape))
