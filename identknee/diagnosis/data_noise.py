"""How large the errors of measured laxity are, and how they hang together."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from identknee.diagnosis.curves import load_curves
from identknee.diagnosis.noise_model import EstimatedScale, estimate_correlation, estimate_scale
from identknee.diagnosis.replicates import (
    correlation_of_replicates,
    replicates_of,
    scale_of_replicates,
)
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity
from identknee.runs.arrays import Array, frozen

# Fewer degrees of freedom say less about the noise than a stated standard deviation does.
LEAST_DEGREES = 40.0
UNITS = {"mm": TRANSLATIONS, "deg": ROTATIONS}
# How well a stated standard deviation is usually known, as that of its logarithm, and from how many
# of its standard deviations on it is taken for a mistake.
STATED_SPREAD, DOUBT = 0.2, 3.0


class NoiseSource(StrEnum):
    """What shows how large the errors are."""

    REPLICATES = "replicates"
    CURVES = "load curves"
    STATED = "stated"

    @property
    def sentence(self) -> str:
        """How it shows it, for a person, the sizes to follow."""
        return {
            NoiseSource.REPLICATES: "Trials under equal loads show a noise of",
            NoiseSource.CURVES: "The roughness of the load curves shows a noise of",
            NoiseSource.STATED: "The noise is taken as stated: the load curves are too short to "
            "show it.",
        }[self]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DataNoise:
    """Standard deviations and correlation of the errors.

    Attributes
    ----------
    sd
        Of every value in its unit, shape ``(n, 5)``; NaN where nothing was measured.
    correlation
        What the errors of a trial share.
    factors
        Found noise over stated noise, of lengths and of angles, NaN for what was not measured; None
        where nothing was stated or found.
    degrees_of_freedom
        Of the standard deviations; infinite where they are taken as stated.
    source
        Where they come from.
    """

    sd: Array
    correlation: float
    factors: tuple[float, float] | None
    degrees_of_freedom: float
    source: NoiseSource

    def __post_init__(self) -> None:
        object.__setattr__(self, "sd", frozen(self.sd, None, None, name="sd"))

    @property
    def sentence(self) -> str:
        """Where they come from and how large they are, for a person."""
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
        return f"{found}, {times} times what the data state."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Noise as the data show it, over the stated one, by unit."""

    scales: Mapping[str, EstimatedScale]
    source: NoiseSource

    @property
    def degrees(self) -> float:
        return sum(x.degrees_of_freedom for x in self.scales.values())


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
    looked = (_in_replicates(laxity, relative), _in_curves(laxity, relative))
    whole = [x for x in looked if all(unit in x.scales for unit in units)]
    seen = max(whole, key=lambda x: x.degrees, default=None)
    if seen is None or seen.degrees < LEAST_DEGREES:
        return _as_stated(laxity)
    sd, factors = stated, dict.fromkeys(UNITS, np.nan)
    for unit in units:
        scale = seen.scales[unit]
        factors[unit] = scale.sd if laxity.sd is None else _weighed(scale)
        sd[:, UNITS[unit]] *= factors[unit]
    shared = _correlation(laxity, residuals / sd, seen.source)
    return DataNoise(
        sd=sd,
        correlation=laxity.within_trial_correlation if shared is None else shared,
        factors=None if laxity.sd is None else (factors["mm"], factors["deg"]),
        degrees_of_freedom=seen.degrees,
        source=seen.source,
    )


def _in_replicates(laxity: Laxity, relative: Array) -> _Seen:
    replicates = replicates_of(laxity)
    found = {unit: scale_of_replicates(replicates, relative, x) for unit, x in UNITS.items()}
    return _seen(found, NoiseSource.REPLICATES)


def _in_curves(laxity: Laxity, relative: Array) -> _Seen:
    measured, curves = laxity.is_measured, load_curves(laxity.protocol)
    found = {
        unit: estimate_scale(relative[:, x], measured[:, x], curves) for unit, x in UNITS.items()
    }
    return _seen(found, NoiseSource.CURVES)


def _seen(found: Mapping[str, EstimatedScale | None], source: NoiseSource) -> _Seen:
    return _Seen(scales={k: x for k, x in found.items() if x is not None}, source=source)


def _correlation(laxity: Laxity, relative: Array, source: NoiseSource) -> float | None:
    """What the errors of a trial share, as the same trials show it that show their size."""
    if source is NoiseSource.REPLICATES:
        return correlation_of_replicates(replicates_of(laxity), relative)
    return estimate_correlation(relative, laxity.is_measured, load_curves(laxity.protocol))


def _weighed(scale: EstimatedScale) -> float:
    """Noise over stated noise from both, by what they are worth; the data's own in doubt."""
    spread = 0.5 / scale.degrees_of_freedom
    seen = np.log(scale.sd)
    if abs(seen) > DOUBT * np.sqrt(spread + STATED_SPREAD**2):
        return scale.sd
    return float(np.exp(seen * STATED_SPREAD**2 / (STATED_SPREAD**2 + spread)))


def _as_stated(laxity: Laxity) -> DataNoise | None:
    if laxity.sd is None:
        return None
    return DataNoise(
        sd=laxity.sd,
        correlation=laxity.within_trial_correlation,
        factors=None,
        degrees_of_freedom=np.inf,
        source=NoiseSource.STATED,
    )
