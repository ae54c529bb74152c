"""What the blind generator shares with the library, varied: one axis a fact."""

from collections.abc import Callable
from functools import cache

import numpy as np

from identknee.blind.conditions import STANDARD, Conditions, TruncatedNormal
from identknee.blind.effects import LISTED
from identknee.model.effects.library import library
from identknee.model.parameters import STRAIN, Parameters, ligament_parameters
from identknee.subject.knee import Knee

PRIOR, TWICE, EXPONENT, REMOUNT, SHIFT = (
    "truths from the stated prior",
    "truths from twice the prior's width",
    "contact exponent 1 to 1.5",
    "errors common to a flexion angle",
    "places shifted by 6 mm",
)


def conditions_of(axis: str, knee: Knee) -> Conditions:
    """What the cases of an axis are drawn from; the standard conditions where it is empty."""
    return _AXES[axis](knee) if axis else STANDARD


def _from_the_prior(width: float, knee: Knee) -> Conditions:
    """Ligament parameters and amplitudes as the library states them, `width` times as spread.

    Truths stay inside the box and the plausible ranges that the library states with them. Places
    of structures have the generator's jitter still: they are an axis of their own.
    """
    one = ligament_parameters(["any"], [10.0], [0.0])
    found = library(knee, has_order=True, has_phase=True)
    structures = next(x for x in found if f"{x.name}.{STRAIN}" in x.parameters.names)
    strain = structures.parameters.index(f"{structures.name}.{STRAIN}")
    return Conditions(
        stiffness_log_sd=width * float(one.prior_sd[0]),
        strain_sd_pct=width * float(one.prior_sd[1]),
        largest_shift_pct=np.inf,
        most_stiffness_kN=float(one.upper[0]),
        most_strain_pct=float(one.upper[1]),
        amplitudes={x.name: _spread(x.parameters, 0, width) for x in found if x.name in LISTED},
        structure_strain_pct=_spread(structures.parameters, strain, width),
    )


def _spread(parameters: Parameters, index: int, width: float) -> TruncatedNormal:
    return TruncatedNormal(
        sd=width * float(parameters.prior_sd[index]),
        center=float(parameters.center[index]),
        lower=float(parameters.lower[index]),
        upper=float(parameters.upper[index]),
    )


_AXES: dict[str, Callable[[Knee], Conditions]] = {
    PRIOR: cache(lambda knee: _from_the_prior(1.0, knee)),
    TWICE: cache(lambda knee: _from_the_prior(2.0, knee)),
    EXPONENT: lambda _: Conditions(exponents=(1.0, 1.5)),
    REMOUNT: lambda _: Conditions(remount_mm=0.3, remount_deg=0.3),
    SHIFT: lambda _: Conditions(shift_mm=6.0),
}
AXES = tuple(_AXES)
