"""How large the errors of measured laxity are, and how they hang together."""

from dataclasses import dataclass

import numpy as np

from identknee.diagnose.curves import load_curves
from identknee.diagnose.noise_model import estimate_correlation, estimate_sds
from identknee.laxity.table import ROTATIONS, TRANSLATIONS, Laxity
from identknee.runs.arrays import Array, frozen

# Fewer degrees of freedom say less about the noise than a stated standard deviation does.
LEAST_DEGREES = 40.0


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
        Found noise over stated noise, of lengths and of angles; NaN where one of both is unknown.
    degrees_of_freedom
        Of the standard deviations; infinite where they are taken as stated.
    sentence
        Where they come from.
    """

    sd: Array
    correlation: float
    factors: tuple[float, float]
    degrees_of_freedom: float
    sentence: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "sd", frozen(self.sd, None, None, name="sd"))


def noise_of(laxity: Laxity, residuals: Array, *, estimates: bool = True) -> DataNoise | None:
    """The noise of the data; None where it is neither stated nor to be seen in them.

    Along a load curve laxity is smooth, so that what is rough there is noise, whatever the model
    gets wrong. With enough points this is trusted more than a stated standard deviation.

    Parameters
    ----------
    laxity
        The data.
    residuals
        Measured less predicted, shape ``(n, 5)``, from a model that follows most of the curvature.
    estimates
        Whether to look at the data; otherwise what they state is taken.
    """
    measured, curves = laxity.is_measured, load_curves(laxity.protocol)
    found = estimate_sds(residuals, measured, curves) if estimates else None
    degrees = 0.0 if found is None else float(found.degrees_of_freedom.sum())
    if found is None or degrees < LEAST_DEGREES:
        if laxity.sd is None:
            return None
        return DataNoise(
            sd=laxity.sd,
            correlation=laxity.within_trial_correlation,
            factors=(np.nan, np.nan),
            degrees_of_freedom=np.inf,
            sentence="The noise is taken as stated: the load curves are too short to show it.",
        )
    sd, factors = np.full(measured.shape, np.nan), []
    for columns in (TRANSLATIONS, ROTATIONS):
        weight = found.degrees_of_freedom[columns]
        stated = np.ones(measured[:, columns].shape) if laxity.sd is None else laxity.sd[:, columns]
        typical = np.sqrt(np.nanmean(np.where(measured[:, columns], stated, np.nan) ** 2, axis=0))
        ratios = found.sd[columns] / typical
        seen = weight > 0
        factor = float(np.sqrt(np.average(ratios[seen] ** 2, weights=weight[seen])))
        sd[:, columns] = factor * stated
        factors.append(factor if laxity.sd is not None else np.nan)
    sd[~measured] = np.nan
    shared = estimate_correlation(residuals / sd, measured, curves)
    return DataNoise(
        sd=sd,
        correlation=laxity.within_trial_correlation if shared is None else shared,
        factors=(factors[0], factors[1]),
        degrees_of_freedom=degrees,
        sentence=_sentence(sd, factors, laxity.sd is not None),
    )


def _sentence(sd: Array, factors: list[float], is_stated: bool) -> str:
    mm, deg = (float(np.nanmedian(sd[:, x])) for x in (TRANSLATIONS, ROTATIONS))
    found = f"The roughness of the load curves shows a noise of {mm:.2g} mm and {deg:.2g} deg"
    if not is_stated:
        return f"{found}; the data state none."
    return f"{found}, {factors[0]:.2f} and {factors[1]:.2f} times what the data state."
