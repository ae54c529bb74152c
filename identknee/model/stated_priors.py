"""Parameters with the priors that a subject states for them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from identknee.model.parameters import Parameters
from identknee.subject.stated_prior import StatedPrior


def with_priors(parameters: Parameters, priors: Mapping[str, StatedPrior]) -> Parameters:
    """A copy with other priors for the parameters named.

    Raises
    ------
    ValueError
        If a name is no parameter's, or a lognormal prior has no centre above 0.

    Examples
    --------
    >>> from identknee.model.parameters import ligament_parameters
    >>> everything = ligament_parameters(["ACL"], [10.0], [8.0])
    >>> with_priors(everything, {"ACL.stiffness_kN": StatedPrior(log_sd=0.5)}).prior_sd.tolist()
    [0.5, 2.0]
    """
    if not priors:
        return parameters
    center, prior_sd = np.array(parameters.center), np.array(parameters.prior_sd)
    is_log, start = np.array(parameters.is_log), np.array(parameters.start)
    for name, prior in priors.items():
        i = parameters.index(name)
        center[i] = start[i] if prior.center is None else prior.center
        prior_sd[i], is_log[i] = prior.spread, prior.is_log
        if prior.is_log and not center[i] > 0.0:
            raise ValueError(
                f"the lognormal prior of {name} needs a centre above 0, got {center[i]:g}"
            )
    return replace(parameters, center=center, prior_sd=prior_sd, is_log=is_log, own=start)
