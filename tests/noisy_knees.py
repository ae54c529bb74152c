"""The problem that sampling is measured on: the 63 trials with noise of a known size."""

from knees import model, own_laxity

from identknee.laxity.table import add_noise
from identknee.model.residuals import LaxityResiduals

NOISE = 0.5  # mm and deg
SEED = 1


def noisy(name: str) -> LaxityResiduals:
    """Residuals of a knee against its own laxity with noise, in units of that noise."""
    of = model(name)
    laxity = add_noise(own_laxity(of), sd_mm=NOISE, sd_deg=NOISE, seed=SEED)
    return LaxityResiduals(model=of, laxity=laxity, weighting="noise")
