"""Whether a structure named lies where anatomy has it, or stands in for another one beside it."""

import numpy as np

from identknee.diagnosis.refit import Refit
from identknee.diagnosis.tails import log_weighted_tail
from identknee.model.effects.placed import Structure

# Of the prior variance of a shift: data that take off less know nothing of it.
LEAST_MOVED = 1e-6


def site_p_value(refit: Refit, structure: Structure) -> float:
    """Probability that the insertions of a structure are found so far from where anatomy has them.

    The shifts found are compared with what their prior, and how much of it the data can move, lead
    one to expect: of a shift with prior variance 1 and posterior variance c, the value found has
    the variance 1 - c. 1 for a structure whose insertions are fixed or that pulls at nothing.

    Parameters
    ----------
    refit
        The fit with the structure.
    structure
        One of its causes.
    """
    p = structure.parameters
    if not structure.sites_vary:
        return 1.0
    shifts = slice(structure.first_shift, None)
    places = refit.places(structure.name)[shifts]
    prior_sd = p.prior_sd[shifts]
    shift = (refit.fitted.theta[places] - p.center[shifts]) / prior_sd
    left = refit.covariance()[np.ix_(places, places)] / np.outer(prior_sd, prior_sd)
    weights = np.clip(np.linalg.eigvalsh(np.eye(len(places)) - left), 0.0, 1.0)
    # Without stiffness the data move no insertion.
    if weights.max() < LEAST_MOVED:
        return 1.0
    return float(np.exp(log_weighted_tail(np.array([shift @ shift]), weights)[0]))


def shift_mm(refit: Refit, structure: Structure) -> float:
    """How far the farther insertion is found from where anatomy has it [mm]."""
    shifts = refit.amplitudes(structure.name)[structure.first_shift :].reshape(-1, 3)
    return float(np.linalg.norm(shifts, axis=1).max(initial=0.0))
