"""The noise of measured laxity and its correlation, from the data."""

from enum import StrEnum
from itertools import combinations

import numpy as np

from identknee.diagnosis.noise_model import (
    LEAST_CORRELATION,
    LEAST_DEGREES,
    MOST_CORRELATION,
    Curve,
    EstimatedScale,
    estimate_correlation,
    estimate_scale,
)
from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity
from identknee.runs.arrays import Array, BoolArray, IntArray
from identknee.runs.declare import array, declared, entry

LEAST_POINTS = 3
# Fewer degrees of freedom say less about the noise than a stated standard deviation does.
TRUSTED_DEGREES = 40.0
UNITS = {"mm": TRANSLATIONS, "deg": ROTATIONS}
# How well a stated standard deviation is usually known, as that of its logarithm, and from how many
# of its standard deviations on it is taken for a mistake.
STATED_SPREAD, DOUBT = 0.2, 3.0


def load_curves(protocol: Protocol) -> tuple[Curve, ...]:
    """Curves of at least three trials of one flexion angle and one varying load.

    The other loads are the same all along a curve. A trial without load may be on several curves;
    of replicates the first is on it.
    """
    curves = []
    for axis in range(len(LOADS)):
        others = np.delete(protocol.loads, axis, axis=1)
        setting = np.column_stack([protocol.flexion_deg, others])
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


@declared
class Replicates:
    """Trials of one flexion angle, equal loads and one phase of loading."""

    group: IntArray = array(
        "Number of the set of equal trials that each belongs to", "trial", dtype=int
    )
    is_measured: BoolArray = entry("Which values there are, shape ``(n, 5)``")

    def deviations(self, values: Array, used: BoolArray) -> Array:
        """`values` (n, k) of the trials `used` (n,) less the mean of their set; 0 for others.

        A model predicts the same for all trials of a set, so that nothing of it is in them.
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
    """Which trials of the data are equal."""
    protocol = laxity.protocol
    _, phase = np.unique(laxity.phase or ("",) * laxity.n, return_inverse=True)
    settings = np.column_stack([protocol.flexion_deg, protocol.loads, phase])
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
    """The correlation that the errors of a trial share; None where too few trials are equal."""
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
    correlation: float = entry("What the errors of a trial share")
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
    """The noise of the data; None where it is neither stated nor to be seen in them.

    Trials under equal loads differ by noise alone; along a load curve laxity is smooth, so that
    what is rough there is noise. Both hold whatever the model gets wrong, and the one with more
    degrees of freedom is believed. A stated standard deviation is taken to be right to 20 %, and
    is weighed with what is found.

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
        factors[unit] = scale.sd if laxity.sd is None else _pooled_noise(scale)
        sd[:, UNITS[unit]] *= factors[unit]
    # What the errors of a trial share, as the same trials show it that show their size.
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
    """Noise over stated noise from both, by what they are worth; the data's own in doubt."""
    spread = 0.5 / scale.degrees_of_freedom
    seen = np.log(scale.sd)
    if abs(seen) > DOUBT * np.sqrt(spread + STATED_SPREAD**2):
        return scale.sd
    return float(np.exp(seen * STATED_SPREAD**2 / (STATED_SPREAD**2 + spread)))
