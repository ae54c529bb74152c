"""A ligament, or a bundle of one: a straight line between two bones."""

from dataclasses import dataclass

import numpy as np

from identknee.runs.arrays import Array, frozen, too_far


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ligament:
    """A line ligament.

    Attributes
    ----------
    name
        What the user calls it; parameters are named ``NAME.stiffness_kN``.
    femur, tibia
        Its insertions in the common frame of the scanned pose [mm], shape ``(3,)``.
    stiffness_kN
        Force per unit strain of its linear region [kN], >= 0.
    reference_strain_pct
        Strain in the scanned pose [%], > -100; negative for a slack ligament.

    Raises
    ------
    ValueError
        If a value is out of range, not finite, or both insertions coincide.
    """

    name: str
    femur: Array
    tibia: Array
    stiffness_kN: float  # noqa: N815 - the key in files
    reference_strain_pct: float

    def __post_init__(self) -> None:
        if not self.name or self.name != self.name.strip() or set(self.name) & set(".,=\"'\n\r\t"):
            raise ValueError(
                f"a ligament needs a name without . , = or quotes, got {self.name!r}; rename it"
            )
        for bone in ("femur", "tibia"):
            place = frozen(getattr(self, bone), 3, name=f"the {bone} insertion of {self.name}")
            if not np.isfinite(place).all():
                raise ValueError(
                    f"the {bone} insertion of {self.name} must be finite numbers in mm, "
                    f"got {place.tolist()}"
                )
            if far := too_far(place):
                raise ValueError(f"the {bone} insertion of {self.name} lies {far}")
            object.__setattr__(self, bone, place)
        if self.length == 0.0:
            raise ValueError(
                f"{self.name} has length zero: both insertions lie at {self.femur.tolist()} mm; "
                "give two different points"
            )
        if not 0.0 <= self.stiffness_kN < np.inf:
            raise ValueError(
                f"the stiffness of {self.name} must be finite and >= 0 kN, "
                f"got {self.stiffness_kN:g}"
            )
        if not -100.0 < self.reference_strain_pct < np.inf:
            raise ValueError(
                f"the reference strain of {self.name} must be finite and > -100 %, "
                f"got {self.reference_strain_pct:g}"
            )

    @property
    def length(self) -> float:
        """Distance of its insertions in the scanned pose [mm]."""
        return float(np.linalg.norm(self.tibia - self.femur))

    def mirrored(self) -> "Ligament":
        """A copy seen in the mirror z = 0."""
        return Ligament(
            name=self.name,
            femur=self.femur * [1.0, 1.0, -1.0],
            tibia=self.tibia * [1.0, 1.0, -1.0],
            stiffness_kN=self.stiffness_kN,
            reference_strain_pct=self.reference_strain_pct,
        )
