"""The parameters of a knee's model, with what the knee states of them."""

from identknee.model.effects.stored import values_of
from identknee.model.extension import joined
from identknee.model.parameters import Parameters, ligament_parameters
from identknee.model.stated_priors import with_priors
from identknee.model.tied import Tied
from identknee.subject.knee import Knee


def knee_parameters(knee: Knee, units: Tied, amplitudes: Parameters | None) -> Parameters:
    """Parameters of the ligaments, then the amplitudes, with priors, bounds and own values.

    Parameters
    ----------
    knee
        The subject.
    units
        Its ligaments, those of a group as one.
    amplitudes
        Those of the effects; None without any.
    """
    parameters = ligament_parameters(
        units.names, units.stiffness_kN.tolist(), units.reference_strain_pct.tolist()
    )
    if amplitudes is not None:
        parameters = joined([parameters, amplitudes])
    known = set(parameters.names)
    priors = {name: x for name, x in knee.priors.items() if name in known}
    bounds = {name: x for name, x in knee.bounds.items() if name in known}
    stored = {**values_of(knee), **knee.fitted}
    own = {name: x for name, x in stored.items() if name in known}
    return with_priors(parameters.with_own(own), priors).with_bounds(bounds)
