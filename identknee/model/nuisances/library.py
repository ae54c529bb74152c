"""The nuisances of a knee: every error that it states, as an effect whose prior is known."""

from identknee.model.effects.effect import Effect
from identknee.model.nuisances.geometry import contact_modulus, insertions, reference_pose
from identknee.model.nuisances.loading import flexion, load_axes, load_gain
from identknee.model.nuisances.registration import Registration
from identknee.subject.knee import Knee


def nuisances_of(knee: Knee) -> tuple[Effect, ...]:
    """What the knee states to be uncertain, in the order in which it acts; empty where nothing is.

    Errors that are the same for every parameter are no part of it: see
    `identknee.model.shared_errors`.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> from identknee.subject.uncertainty import Uncertainty
    >>> knee = reference_knee().with_uncertainty(Uncertainty(load_gain=0.03))
    >>> [x.name for x in nuisances_of(knee)]
    ['load_gain']
    """
    stated = knee.uncertainty
    made: list[Effect] = []
    if not isinstance(stated.insertions_mm, float) or stated.insertions_mm > 0.0:
        made.append(insertions(knee))
    if stated.reference_pose_deg > 0.0 or stated.reference_pose_mm > 0.0:
        made.append(reference_pose(stated.reference_pose_deg, stated.reference_pose_mm))
    if stated.contact_modulus > 0.0:
        made.append(contact_modulus(stated.contact_modulus))
    if stated.load_gain > 0.0:
        made.append(load_gain(stated.load_gain))
    if stated.load_axes_deg > 0.0:
        made.append(load_axes(stated.load_axes_deg))
    if stated.flexion_deg > 0.0:
        made.append(flexion(stated.flexion_deg))
    if stated.registration_deg > 0.0 or stated.registration_mm > 0.0:
        made.append(Registration(sd_deg=stated.registration_deg, sd_mm=stated.registration_mm))
    return tuple(made)
