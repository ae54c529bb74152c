"""How large the errors of measured laxity are, and how they hang together."""

from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.curves import load_curves
from identknee.diagnosis.noise_model import EstimatedScale, estimate_correlation, estimate_scale
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity
from identknee.runs.arrays import Array, frozen

# Fewer degrees of freedom say less about the noise than a stated standard deviation does.
LEAST_DEGREES = 40.0
# How well a stated standard deviation is usually known, as that of its logarithm, and from how many
# of its standard deviations on it is taken for a mistake.
STATED_SPREAD, DOUBT = 0.2, 3.0


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
    sentence
        Where they come from.
    """

    sd: Array
    correlation: float
    factors: tuple[float, float] | None
    degrees_of_freedom: float
    sentence: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "sd", frozen(self.sd, None, None, name="sd"))


def noise_of(laxity: Laxity, residuals: Array) -> DataNoise | None:
    """The noise of the data; None where it is neither stated nor to be seen in them.

    Along a load curve laxity is smooth, so that what is rough there is noise, whatever the model
    gets wrong. A stated standard deviation is taken to be right to 20 %, and both are weighed.

    Parameters
    ----------
    laxity
        The data.
    residuals
        Measured less predicted, shape ``(n, 5)``, from a model that follows most of the curvature.
    """
    measured, curves = laxity.is_measured, load_curves(laxity.protocol)
    stated = np.where(measured, 1.0, np.nan) if laxity.sd is None else np.array(laxity.sd)
    relative = residuals / stated
    groups = [x for x in (TRANSLATIONS, ROTATIONS) if measured[:, x].any()]
    found = [estimate_scale(relative[:, x], measured[:, x], curves) for x in groups]
    degrees = sum(x.degrees_of_freedom for x in found if x is not None)
    if None in found or degrees < LEAST_DEGREES:
        return _as_stated(laxity)
    sd, factors = stated, dict.fromkeys(("mm", "deg"), np.nan)
    for columns, scale in zip(groups, found, strict=True):
        if scale is not None:
            factor = scale.sd if laxity.sd is None else _weighed(scale)
            sd[:, columns] *= factor
            factors["mm" if columns is TRANSLATIONS else "deg"] = factor
    shared = estimate_correlation(residuals / sd, measured, curves)
    return DataNoise(
        sd=sd,
        correlation=laxity.within_trial_correlation if shared is None else shared,
        factors=None if laxity.sd is None else (factors["mm"], factors["deg"]),
        degrees_of_freedom=degrees,
        sentence=_sentence(sd, None if laxity.sd is None else list(factors.values())),
    )


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
        sentence="The noise is taken as stated: the load curves are too short to show it.",
    )


def _sentence(sd: Array, factors: list[float] | None) -> str:
    sizes = []
    for columns, unit in ((TRANSLATIONS, "mm"), (ROTATIONS, "deg")):
        if np.isfinite(sd[:, columns]).any():
            sizes.append(f"{np.nanmedian(sd[:, columns]):.2g} {unit}")
    found = f"The roughness of the load curves shows a noise of {' and '.join(sizes)}"
    if factors is None:
        return f"{found}; the data state none."
    times = " and ".join(f"{x:.2f}" for x in factors if np.isfinite(x))
    return f"{found}, {times} times what the data state."
