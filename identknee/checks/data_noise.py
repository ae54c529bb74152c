"""The noise of measured laxity and its correlation; whether equal trials differ by more."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import combinations

import numpy as np
from scipy.sparse import csr_array

from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.runs.declare import Array, BoolArray, IntArray, array, declared, entry
from identknee.runs.findings import Finding, finding

# Degree of the polynomial that is removed along a load curve; the residuals are the noise.
CURVE_DEGREE = 4
# Degrees of freedom that a polynomial must leave, or the curve is not used.
LEAST_LEFT = 2
# Total degrees of freedom below which a correlation or a standard deviation is not estimated.
LEAST_DEGREES = 8.0
# Consecutive points from which one deviation from a cubic is computed.
WINDOW = 5
# Share of normal errors within one standard deviation, and the efficiency of that quantile.
WITHIN_ONE_SD, QUANTILE_EFFICIENCY = 0.6827, 0.54
# Limits of an estimated correlation, beyond which a covariance is nearly singular.
LEAST_CORRELATION, MOST_CORRELATION = -0.2, 0.95
LEAST_POINTS = 3
# Degrees of freedom below which an estimate is worse than a stated standard deviation.
TRUSTED_DEGREES = 40.0
UNITS = {"mm": TRANSLATIONS, "deg": ROTATIONS}
# Standard deviation of the logarithm of a stated standard deviation, an assumption, and how many of
# these it may be off before it is taken for a mistake.
STATED_SPREAD, DOUBT = 0.2, 3.0


@declared
class Curve:
    """Trials of one flexion angle that differ in one load, in the order of that load.

    Raises
    ------
    ValueError
        If the loads do not increase or are not one for each trial.
    """

    trials: IntArray = array(
        "Rows of the table. A trial without load may be on several curves", "trial", dtype=int
    )
    load: Array = array("The load of each, increasing, in any unit", "trial")

    def __post_init__(self) -> None:
        if np.any(np.diff(self.load) <= 0):
            raise ValueError("the loads of a curve must increase; sort its trials, one for a load")


def load_curves(protocol: Protocol) -> tuple[Curve, ...]:
    """Curves of at least three trials of one flexion angle and state, over one load.

    The other loads are constant along a curve. A trial without load may be on several curves; of
    equal trials the first is taken.
    """
    curves = []
    for axis in range(len(LOADS)):
        others = np.delete(protocol.loads, axis, axis=1)
        setting = np.column_stack([protocol.series, protocol.flexion_deg, others])
        _, place, count = np.unique(setting, axis=0, return_inverse=True, return_counts=True)
        order = np.argsort(place.ravel(), kind="stable")
        for end, n in zip(np.cumsum(count).tolist(), count.tolist(), strict=True):
            if n < LEAST_POINTS:
                continue
            members = order[end - n : end]
            load, first = np.unique(protocol.loads[members, axis], return_index=True)
            if len(load) >= LEAST_POINTS:
                curves.append(Curve(trials=members[first], load=load))
    return tuple(curves)


def estimate_correlation(
    residuals: Array, is_measured: BoolArray, curves: Sequence[Curve]
) -> float | None:
    """Correlation of the errors within a trial; None if there are too few data.

    A quartic is removed along every load curve, so that smooth misfit does not count as noise; on
    short curves the degree is lower. The result is the mean correlation of what remains, over all
    pairs of coordinates.

    Parameters
    ----------
    residuals
        Measured less predicted, in units of the stated standard deviations (or with one standard
        deviation a coordinate), shape ``(n, 5)``; read where measured.
    is_measured
        Which values there are, shape ``(n, 5)``.
    curves
        The load curves of the protocol.
    """
    found = []
    for first, second in combinations(range(residuals.shape[1]), 2):
        used = is_measured[:, first] & is_measured[:, second]
        # The sum over curves of the projections that remove a polynomial, shape ``(n, n)``.
        parts = [(np.zeros(0), np.zeros((2, 0), int))]
        for curve in curves:
            on = used[curve.trials]
            trials, load = curve.trials[on], curve.load[on]
            degree = min(CURVE_DEGREE, len(trials) - 1 - LEAST_LEFT)
            if degree >= 1:
                rough = _off_polynomials(tuple(load.tolist()), degree)
                parts.append((rough.ravel(), np.stack(np.meshgrid(trials, trials)).reshape(2, -1)))
        left = _sparse(parts, len(used), len(used))
        if _degrees_of_freedom(left) < LEAST_DEGREES:
            continue
        pair = np.where(used[:, None], residuals[:, [first, second]], 0.0)
        products = pair.T @ (left @ pair)
        size = np.sqrt(products[0, 0] * products[1, 1])
        if size > 0:
            found.append(products[0, 1] / size)
    if not found:
        return None
    return float(np.clip(np.mean(found), LEAST_CORRELATION, MOST_CORRELATION))


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatedScale:
    """The size of the noise, estimated from load curves or equal trials.

    Attributes
    ----------
    sd
        Standard deviation, in the unit of the values.
    degrees_of_freedom
        Degrees of freedom of the estimate.
    """

    sd: float
    degrees_of_freedom: float


def estimate_scale(
    values: Array, is_measured: BoolArray, curves: Sequence[Curve]
) -> EstimatedScale | None:
    """The common noise of some columns, from deviations from a cubic on five points of a curve.

    It stands for pure error in data without replicates. Kinks of a curve and outliers must not
    count as noise, so the standard deviation is the 68 % quantile of the deviations. None if there
    are too few points.

    Parameters
    ----------
    values
        Measured less predicted, or the measured values, in units of their noise up to one common
        factor, shape ``(n, k)``; read where measured.
    is_measured
        Which values there are, shape ``(n, k)``.
    curves
        The load curves of the protocol.

    References
    ----------
    T. Gasser, L. Sroka and C. Jennen-Steinmetz, Residual variance and residual pattern in nonlinear
    regression, Biometrika 73 (1986) 625-633, doi:10.1093/biomet/73.3.625.
    """
    found, degrees = [], 0.0
    for column in range(values.shape[1]):
        used = is_measured[:, column]
        # Contrasts of five consecutive points that a cubic leaves at zero, a row each, ``(c, n)``.
        parts, n_rows = [(np.zeros(0), np.zeros((2, 0), int))], 0
        for curve in curves:
            on = used[curve.trials]
            trials, load = curve.trials[on], curve.load[on]
            for start in range(len(trials) - WINDOW + 1):
                window = slice(start, start + WINDOW)
                contrast = _contrast(tuple(load[window].tolist()))
                parts.append((contrast, np.stack([np.full(WINDOW, n_rows), trials[window]])))
                n_rows += 1
        contrasts = _sparse(parts, n_rows, len(used))
        degrees += _degrees_of_freedom(contrasts.T @ contrasts)
        found.append(contrasts @ np.where(used, values[:, column], 0.0))
    degrees *= QUANTILE_EFFICIENCY
    if degrees < LEAST_DEGREES:
        return None
    sd = float(np.quantile(np.abs(np.concatenate(found)), WITHIN_ONE_SD))
    return EstimatedScale(sd=sd, degrees_of_freedom=degrees)


def _sparse(parts: Sequence[tuple[Array, IntArray]], rows: int, columns: int) -> csr_array:
    """The sum of entries given with their places (2, k), shape ``(rows, columns)``."""
    values, places = zip(*parts, strict=True)
    return csr_array((np.concatenate(values), np.concatenate(places, axis=1)), (rows, columns))


def _degrees_of_freedom(left: csr_array) -> float:
    """Degrees of freedom of the quadratic form `left`, by its first two moments."""
    squares = float(np.sum(left.data**2))
    return float(left.diagonal().sum()) ** 2 / squares if squares > 0 else 0.0


# Cached, because it is the same for every column and for every table of one protocol.
@lru_cache(maxsize=1024)
def _off_polynomials(load: tuple[float, ...], degree: int) -> Array:
    """The projection that removes a polynomial of the load, shape ``(k, k)``."""
    smooth, _ = np.linalg.qr(_powers(np.array(load), degree))
    return np.asarray(np.eye(len(load)) - smooth @ smooth.T)


@lru_cache(maxsize=1024)
def _contrast(load: tuple[float, ...]) -> Array:
    """Unit contrast of k values that is zero for polynomials up to degree k - 2, ``(k,)``."""
    whole, _ = np.linalg.qr(_powers(np.array(load), len(load) - 2), mode="complete")
    return np.asarray(whole[:, -1])


def _powers(load: Array, degree: int) -> Array:
    """Powers of the load scaled to -1 to 1, shape ``(k, degree + 1)``."""
    middle, half = (load[-1] + load[0]) / 2, (load[-1] - load[0]) / 2
    return np.vander((load - middle) / half, degree + 1)


@declared
class Replicates:
    """Trials of one flexion angle, equal loads and one phase of loading."""

    group: IntArray = array(
        "Number of the set of equal trials that each belongs to", "trial", dtype=int
    )
    is_measured: BoolArray = entry("Which values there are, shape ``(n, 5)``")

    def deviations(self, values: Array, used: BoolArray) -> Array:
        """`values` (n, k) of the trials `used` (n,) less the mean of their set; 0 for others.

        They do not depend on a model, which predicts the same for all trials of a set.
        """
        known = np.where(used[:, None], values, 0.0)
        n_groups = int(self.group.max()) + 1
        sums = np.zeros((n_groups, known.shape[1]))
        np.add.at(sums, self.group, known)
        count = np.bincount(self.group[used], minlength=n_groups)
        means = sums / np.maximum(count, 1)[:, None]
        return np.where(used[:, None], known - means[self.group], 0.0)

    def degrees(self, used: BoolArray) -> int:
        """Degrees of freedom of the deviations in one column."""
        return int(used.sum()) - len(np.unique(self.group[used]))


def replicates_of(laxity: Laxity) -> Replicates:
    """Which trials of the data are equal: in one experiment and state of the knee."""
    protocol = laxity.protocol
    _, phase = np.unique(laxity.phase or ("",) * laxity.n, return_inverse=True)
    settings = np.column_stack([protocol.series, protocol.flexion_deg, protocol.loads, phase])
    group = np.unique(settings, axis=0, return_inverse=True)[1]
    return Replicates(group=group.ravel(), is_measured=laxity.is_measured)


def scale_of_replicates(
    replicates: Replicates, values: Array, columns: slice
) -> EstimatedScale | None:
    """The common noise of some columns, pure error; None where too few trials are equal.

    Parameters
    ----------
    replicates
        Which trials are equal.
    values
        Measured less predicted, or the measured values, in units of their noise up to one common
        factor, shape ``(n, 5)``.
    columns
        Which of them.
    """
    squares, degrees = 0.0, 0
    for column in range(values.shape[1])[columns]:
        used = replicates.is_measured[:, column]
        squares += float((replicates.deviations(values[:, [column]], used) ** 2).sum())
        degrees += replicates.degrees(used)
    if degrees < LEAST_DEGREES:
        return None
    return EstimatedScale(sd=float(np.sqrt(squares / degrees)), degrees_of_freedom=float(degrees))


def correlation_of_replicates(replicates: Replicates, values: Array) -> float | None:
    """Correlation of the errors within a trial; None if too few trials are equal."""
    found = []
    for pair in combinations(range(values.shape[1]), 2):
        used = np.asarray(replicates.is_measured[:, pair].all(axis=1))
        if replicates.degrees(used) < LEAST_DEGREES:
            continue
        left = replicates.deviations(values[:, pair], used)
        products = left.T @ left
        size = np.sqrt(products[0, 0] * products[1, 1])
        if size > 0:
            found.append(products[0, 1] / size)
    return float(np.clip(np.mean(found), LEAST_CORRELATION, MOST_CORRELATION)) if found else None


class NoiseSource(StrEnum):
    """The source of a noise estimate."""

    REPLICATES = "replicates"
    CURVES = "load curves"
    STATED = "stated"

    @property
    def sentence(self) -> str:
        """The source as the start of a sentence."""
        return {
            NoiseSource.REPLICATES: "Repeated trials give an estimated noise of",
            NoiseSource.CURVES: "The scatter along the load curves gives an estimated noise of",
            NoiseSource.STATED: "The noise is used as stated: the load curves are too short to "
            "estimate it.",
        }[self]


@declared
class DataNoise:
    """Standard deviations and correlation of the errors."""

    sd: Array = array(
        "Standard deviation of every value in its unit; NaN where nothing was measured",
        "trial",
        "coordinate",
    )
    correlation: float = entry("Correlation of the errors within a trial")
    factors: tuple[float, float] | None = entry(
        "Found noise over stated noise, of lengths and of angles, NaN for what was not measured; "
        "None where nothing was stated or found"
    )
    degrees_of_freedom: float = entry(
        "Degrees of freedom of the standard deviations; infinite where they are taken as stated"
    )
    source: NoiseSource = entry("Where they come from")

    @property
    def sentence(self) -> str:
        """Source and size of the noise, as a sentence."""
        if self.source is NoiseSource.STATED:
            return self.source.sentence
        sizes = [
            f"{np.nanmedian(self.sd[:, columns]):.2g} {unit}"
            for unit, columns in UNITS.items()
            if np.isfinite(self.sd[:, columns]).any()
        ]
        found = f"{self.source.sentence} {' and '.join(sizes)}"
        if self.factors is None:
            return f"{found}; the data state none."
        times = " and ".join(f"{x:.2f}" for x in self.factors if np.isfinite(x))
        return f"{found}, {times} times the stated noise."


def noise_of(laxity: Laxity, residuals: Array) -> DataNoise | None:
    """The noise of the data; None if it is neither stated nor can be estimated from them.

    Trials under equal loads differ by noise alone. Laxity is smooth along a load curve, so that
    deviations from a smooth curve are noise. Both hold whatever the model gets wrong; the estimate
    with more degrees of freedom is taken. A stated standard deviation is assumed to be right to
    20 % and is combined with the estimate.

    Parameters
    ----------
    laxity
        The data.
    residuals
        Measured less predicted, shape ``(n, 5)``, from a model that follows most of the curvature.
    """
    measured = laxity.is_measured
    stated = np.where(measured, 1.0, np.nan) if laxity.sd is None else np.array(laxity.sd)
    relative = residuals / stated
    units = [unit for unit, columns in UNITS.items() if measured[:, columns].any()]
    replicates, curves = replicates_of(laxity), load_curves(laxity.protocol)
    in_replicates = {x: scale_of_replicates(replicates, relative, k) for x, k in UNITS.items()}
    in_curves = {
        x: estimate_scale(relative[:, k], measured[:, k], curves) for x, k in UNITS.items()
    }
    looked = [(NoiseSource.STATED, dict[str, EstimatedScale](), -np.inf)]
    for source, found in (
        (NoiseSource.REPLICATES, in_replicates),
        (NoiseSource.CURVES, in_curves),
    ):
        scales = {unit: x for unit, x in found.items() if x is not None}
        if all(unit in scales for unit in units):
            looked.append((source, scales, sum(x.degrees_of_freedom for x in scales.values())))
    source, scales, degrees = max(looked, key=lambda x: x[2])
    if degrees < TRUSTED_DEGREES:
        if laxity.sd is None:
            return None
        return DataNoise(
            sd=laxity.sd,
            correlation=laxity.within_trial_correlation,
            factors=None,
            degrees_of_freedom=np.inf,
            source=NoiseSource.STATED,
        )
    sd, factors = stated, dict.fromkeys(UNITS, np.nan)
    for unit in units:
        scale = scales[unit]
        size = scale.sd if laxity.sd is None else _pooled_noise(scale)
        # Data without noise give an estimate of zero.
        factors[unit] = max(size, np.finfo(float).tiny)
        sd[:, UNITS[unit]] *= factors[unit]
    # The correlation comes from the same source as the standard deviations.
    if source is NoiseSource.REPLICATES:
        shared = correlation_of_replicates(replicates, residuals / sd)
    else:
        shared = estimate_correlation(residuals / sd, measured, curves)
    return DataNoise(
        sd=sd,
        correlation=laxity.within_trial_correlation if shared is None else shared,
        factors=None if laxity.sd is None else (factors["mm"], factors["deg"]),
        degrees_of_freedom=degrees,
        source=source,
    )


def _pooled_noise(scale: EstimatedScale) -> float:
    """Noise over stated noise: the weighted mean of both; the data's own if they contradict."""
    spread = 0.5 / scale.degrees_of_freedom
    seen = np.log(max(scale.sd, np.finfo(float).tiny))
    if abs(seen) > DOUBT * np.sqrt(spread + STATED_SPREAD**2):
        return scale.sd
    return float(np.exp(seen * STATED_SPREAD**2 / (STATED_SPREAD**2 + spread)))


# Times the noise beyond which the scatter of equal trials is reported.
MOST = 4.0
# Assumed noise [mm, deg] where none is stated: more than replicates of any rig have.
LARGE_MM, LARGE_DEG = 1.0, 2.0


def replicates_findings(laxity: Laxity, noise_mm: float | None = None) -> tuple[Finding, ...]:
    """A finding if equal trials are further apart than their noise allows.

    Parameters
    ----------
    laxity
        The data. Trials of one state, experiment and phase are compared.
    noise_mm
        Standard deviation of lengths where one is stated beside the table.
    """
    spread = np.empty(laxity.coordinates.shape)
    spread[:, TRANSLATIONS], spread[:, ROTATIONS] = LARGE_MM, LARGE_DEG
    spread *= max(1.0, (noise_mm or 0.0) / LARGE_MM)
    if laxity.sd is not None:
        spread = np.where(np.isnan(laxity.sd), spread, laxity.sd)
    replicates = replicates_of(laxity)
    group, n_groups = replicates.group, int(replicates.group.max(initial=-1)) + 1
    squares, degrees = np.zeros(n_groups), np.zeros(n_groups)
    for column, used in enumerate(laxity.is_measured.T):
        scaled = laxity.coordinates[:, [column]] / spread[:, [column]]
        np.add.at(squares, group, replicates.deviations(scaled, used)[:, 0] ** 2)
        degrees += np.maximum(np.bincount(group[used], minlength=n_groups) - 1, 0)
    is_apart = squares > MOST**2 * np.maximum(degrees, 1.0)
    if not is_apart.any():
        return ()
    rows = np.flatnonzero(group == int(np.argmax(squares / np.maximum(degrees, 1.0))))
    column, (one, other) = _farthest(laxity.coordinates[rows] / spread[rows])
    first, second = rows[one], rows[other]
    off = abs(float(laxity.coordinates[first, column] - laxity.coordinates[second, column]))
    unit = COORDINATES[column].rpartition("_")[2]
    names = [laxity.protocol.trials[i] for i in sorted((first, second))]
    n, total = int(is_apart.sum()), int((degrees > 0).sum())
    sentence = (
        f"Trials under equal loads differ by more than noise explains ({n} of {total} repeats): "
        f"{names[0]} and {names[1]} differ by {off:.2g} {unit}. Several states or knees in one "
        "table need a column state or tables of their own."
    )
    values = {"n_apart": n, "n_repeated": total, "first": names[0], "second": names[1]}
    return (finding("replicates-apart", "data", {**values, f"off_{unit}": off}, sentence=sentence),)


def _farthest(scaled: Array) -> tuple[int, tuple[int, int]]:
    """The column in which some of the rows are farthest apart, and which two."""
    lost = np.isnan(scaled)
    low, high = np.where(lost, np.inf, scaled), np.where(lost, -np.inf, scaled)
    column = int(np.argmax(high.max(axis=0) - low.min(axis=0)))
    return column, (int(low[:, column].argmin()), int(high[:, column].argmax()))
