"""The nuisances of a knee: every error that it states, as an effect whose prior is known."""

from collections.abc import Callable
from types import MappingProxyType

from identknee.mechanics.contact_law import MOST_ROUNDING
from identknee.model.effects.changes import held
from identknee.model.effects.effect import Effect
from identknee.model.nuisances.geometry import (
    contact_exponent,
    contact_modulus,
    insertions,
    reference_pose,
    toe_region,
)
from identknee.model.nuisances.loading import flexion, load_axes, load_gain
from identknee.model.nuisances.registration import Registration
from identknee.subject.knee import Knee

# Errors that a subject may hold without their being uncertain, at any spread: it does not count.
_HELD = MappingProxyType[str, Callable[[], Effect]](
    {
        "reference_pose": lambda: reference_pose(1.0, 1.0),
        "contact_modulus": lambda: contact_modulus(1.0),
        "contact_exponent": lambda: contact_exponent(1.0),
        "toe_region": lambda: toe_region(1.0),
        "load_gain": lambda: load_gain(1.0),
        "load_axes": lambda: load_axes(1.0),
        "flexion": lambda: flexion(1.0),
        "registration": lambda: Registration(sd_deg=1.0, sd_mm=1.0),
    }
)


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
    if stated.contact_exponent > 0.0:
        made.append(contact_exponent(stated.contact_exponent))
    if stated.toe_region > 0.0:
        made.append(toe_region(stated.toe_region))
    if stated.load_gain > 0.0:
        made.append(load_gain(stated.load_gain))
    if stated.load_axes_deg > 0.0:
        made.append(load_axes(stated.load_axes_deg))
    if stated.flexion_deg > 0.0:
        made.append(flexion(stated.flexion_deg))
    if stated.registration_deg > 0.0 or stated.registration_mm > 0.0:
        made.append(Registration(sd_deg=stated.registration_deg, sd_mm=stated.registration_mm))
    return tuple(made)


def contact_rounding(knee: Knee) -> float:
    """Rounding of the contact law of a knee [mm]: the most where geometry or tests are uncertain.

    There a search goes far along bent valleys, and the stiffness of the joint jumps wherever a
    contact point begins to touch: kinks at which no derivative tells of the other side. Predictions
    change by 0.02 mm and 0.04 deg rms at most (two knees, 63 trials). Exact geometry keeps the law
    it was fitted with, which is the paper's unless the knee says otherwise.
    """
    return MOST_ROUNDING if nuisances_of(knee) else knee.contact_rounding_mm


def held_errors(knee: Knee) -> tuple[Effect, ...]:
    """Errors stored with the knee that it does not state to be uncertain, at their stored sizes.

    Raises
    ------
    ValueError
        If a stored error has no such part.
    """
    stated = {x.name for x in nuisances_of(knee)}
    made = []
    for choice in knee.effects:
        if choice.name in stated or choice.name not in _HELD:
            continue
        effect = _HELD[choice.name]()
        sizes = dict.fromkeys(effect.parameters.names, 0.0)
        for name, value in choice.values.items():
            effect.parameters.index(f"{choice.name}.{name}")
            sizes[f"{choice.name}.{name}"] = value
        made.append(held(effect, sizes))
    return tuple(made)
