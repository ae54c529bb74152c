"""Trials that the others contradict: leave-one-out residuals of a fit, many looks allowed for."""

import numpy as np
from scipy.special import fdtrc

from identknee.runs.arrays import Array, IntArray
from identknee.runs.declare import array, declared, entry

# How often a clean table may be accused, shared by looks at whole trials and at single values.
LEVEL = 0.01
# Share of the trials that may be blunders; where more stand out it is the model that is wrong.
MOST_SHARE = 0.1
# What is left of a value by the fitted parameters, below which nothing can be said of it.
LEAST_LEFT = 1e-6
# Mean square in units of the noise below which data are free of noise, and rounding is left.
LEAST_SQUARE = 1e-6


@declared
class SuspiciousRow:
    """A trial that does not go with all others, its worst values first."""

    trial: int = entry("Its place among the trials")
    coordinates: IntArray = array("Places of its coordinates", "value", dtype=int)
    off: Array = array("How far each is from what the other trials say", "value", unit="mm or deg")
    errors: Array = array("Standard errors of those distances", "value", unit="mm or deg")
    p_value: float = entry("How often one of so many is as far off by chance", unit="1")

    @property
    def times(self) -> Array:
        """How far off each is in its standard errors."""
        return np.abs(self.off) / self.errors


@declared
class LeftOut:
    """What a fit leaves of every measured value, ready to leave any of them out.

    A value that is wrong by ``x`` adds ``x`` times its column to what is left. With one more
    parameter for each value left out this is exact for a straight model.
    """

    products: Array = array("Inner products of those columns", "value", "value")
    left: Array = array("Inner products of what is left with them", "value")
    square: float = entry("Sum of squares of what is left", unit="1")
    degrees: int = entry("Degrees of freedom of it", unit="1")

    def fall(self, chosen: IntArray) -> float:
        """By how much the square falls without the values `chosen`."""
        block = self.products[np.ix_(chosen, chosen)]
        return float(self.left[chosen] @ _inverse(block) @ self.left[chosen])

    def without(self, chosen: IntArray) -> "LeftOut":
        """What is left without the values `chosen`."""
        block, columns = self.products[np.ix_(chosen, chosen)], self.products[:, chosen]
        half = _inverse(block) @ np.column_stack([columns.T, self.left[chosen]])
        return LeftOut(
            products=self.products - columns @ half[:, :-1],
            left=self.left - columns @ half[:, -1],
            square=max(self.square - self.fall(chosen), 0.0),
            degrees=self.degrees - len(chosen),
        )


def _inverse(block: Array) -> Array:
    """Of inner products, some of which may be nothing but others together."""
    return np.asarray(np.linalg.pinv(block, rcond=LEAST_LEFT, hermitian=True), float)


def left_out(residuals: Array, jacobian: Array, columns: Array) -> LeftOut:
    """What a fit leaves, from its residuals in units of their noise.

    Parameters
    ----------
    residuals
        Measured less predicted, whitened, rows of priors included, shape ``(m,)``.
    jacobian
        Their derivatives by the parameters that are free, shape ``(m, p)``.
    columns
        How each measured value enters the residuals, shape ``(m, k)``.
    """
    sizes = np.linalg.norm(jacobian, axis=0)
    used = jacobian[:, sizes > 0.0] / sizes[sizes > 0.0]
    basis, spread, _ = np.linalg.svd(used, full_matrices=False)
    basis = basis[:, spread > LEAST_LEFT * spread.max(initial=0.0)]
    rest = residuals - basis @ (basis.T @ residuals)
    free = columns - basis @ (basis.T @ columns)
    return LeftOut(
        products=free.T @ free,
        left=free.T @ rest,
        square=float(rest @ rest),
        degrees=len(residuals) - basis.shape[1],
    )


def suspicious_rows(
    fit: LeftOut, trials: IntArray, coordinates: IntArray, *, level: float = LEVEL
) -> list[SuspiciousRow]:
    """The trials that the others contradict, the worst first; none where there are too many.

    One trial at a time is left out, each judged by a scale that it has no part in (an F test of
    the whole trial and of each of its values, Bonferroni over all), then the rest are judged again
    without it.

    Parameters
    ----------
    fit
        What the fit leaves.
    trials, coordinates
        Trial and coordinate of each value, shape ``(k,)``.
    level
        How often a clean table may be accused.
    """
    found: list[SuspiciousRow] = []
    names = np.unique(trials)
    if fit.square < LEAST_SQUARE * fit.degrees:
        return found
    while fit.degrees > len(names) // 2:
        looked = [(_p_value_of(fit, trials, x), x) for x in names.tolist()]
        p_value, worst = min(looked, default=(1.0, -1))
        if p_value > level:
            return found
        if len(found) >= max(1, int(MOST_SHARE * len(names))):
            return []
        own = _seen(fit, trials, worst)
        found.append(_described(fit, own, worst, coordinates, p_value))
        fit = fit.without(own)
    return found


def _p_value_of(fit: LeftOut, trials: IntArray, trial: int) -> float:
    """Of one trial, as one of all trials and of all values; 1 where nothing can be said."""
    own = _seen(fit, trials, trial)
    if not own.size or fit.degrees <= own.size:
        return 1.0
    whole = _p_value(fit, fit.fall(own), own.size)
    single = _p_value(fit, float((fit.left[own] ** 2 / np.diag(fit.products)[own]).max()), 1)
    return min(1.0, 2.0 * min(np.unique(trials).size * whole, trials.size * single))


def _described(
    fit: LeftOut, own: IntArray, trial: int, coordinates: IntArray, p_value: float
) -> SuspiciousRow:
    size = np.diag(fit.products)[own]
    off = fit.left[own] / size
    errors = np.sqrt(max(fit.square - fit.fall(own), 0.0) / (fit.degrees - own.size) / size)
    order = np.argsort(-np.abs(off) / errors)
    return SuspiciousRow(
        trial=trial,
        coordinates=coordinates[own[order]],
        off=off[order],
        errors=errors[order],
        p_value=p_value,
    )


def _p_value(fit: LeftOut, fall: float, k: int) -> float:
    """Probability of so great a fall of the square by chance if `k` values are left out."""
    degrees = fit.degrees - k
    rest = max(fit.square - fall, 0.0) / degrees
    return float(fdtrc(k, degrees, fall / k / rest)) if rest > 0.0 else 1.0


def _seen(fit: LeftOut, trials: IntArray, trial: int) -> IntArray:
    """The values of a trial whose change the parameters and trials left out cannot make up for."""
    chosen = np.flatnonzero(trials == trial)
    size = np.diag(fit.products)
    return np.asarray(chosen[size[chosen] > LEAST_LEFT * size.max()])
