"""The pressure between two cartilage surfaces, as a function of how deep one lies in the other."""

from dataclasses import dataclass

import numpy as np

from identknee.runs.arrays import Array

PRESSURE_MODULUS = 10.0  # N/mm3, the paper's 10 GN/m3
# mm; at this depth the pressure does not depend on the exponent of the law.
REFERENCE_DEPTH = 0.3
# mm; the distance field keeps what comes this near.
MOST_ROUNDING = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactLaw:
    """Pressure of the contact, ``modulus depth (depth / REFERENCE_DEPTH)^(exponent - 1)``.

    Attributes
    ----------
    modulus
        [N/mm3], > 0.
    exponent
        Exponent of the depth, > 0; the paper's law has 1.
    rounding
        Gap at which the pressure begins [mm], 0 to 0.15, and depth from which it is the law's
        again; the paper's law has 0. Between them the depth counts as the parabola
        ``(depth + rounding)^2 / (4 rounding)``, which joins zero and the depth itself without a
        kink, so that a contact point which begins to touch does not change the stiffness of the
        joint at once.

    Raises
    ------
    ValueError
        If the rounding is negative or larger than the distance field allows for.
    """

    modulus: float = PRESSURE_MODULUS
    exponent: float = 1.0
    rounding: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.rounding <= MOST_ROUNDING:
            raise ValueError(
                f"the rounding of the contact law must be 0 to {MOST_ROUNDING:g} mm, got "
                f"{self.rounding:g}; leave it out for the law without rounding"
            )

    def pressure(self, depth: Array) -> tuple[Array, Array]:
        """Pressure [N/mm2] at depths [mm], negative for gaps, and its derivative [N/mm3]."""
        reach = np.maximum(depth + self.rounding, 0.0)
        is_rounded = depth < self.rounding
        steepness = reach / (2.0 * self.rounding) if self.rounding else np.zeros_like(reach)
        felt = np.where(is_rounded, 0.5 * reach * steepness, reach - self.rounding)
        slope = np.where(is_rounded, steepness, 1.0)
        spring = self.modulus * np.where(felt > 0.0, felt, 1.0) ** (self.exponent - 1.0)
        spring /= REFERENCE_DEPTH ** (self.exponent - 1.0)
        return np.asarray(spring * felt), np.asarray(
            np.where(felt > 0.0, self.exponent * spring * slope, 0.0)
        )
