"""Posterior capsule: two lines that differ in stiffness."""

from dataclasses import dataclass, field

import numpy as np

from identknee.model.effects.effect import amplitudes
from identknee.model.effects.structures import SHIFTS, MissingStructure
from identknee.model.parameters import STIFFNESS, STRAIN, Parameters
from identknee.model.setting import Setting
from identknee.runs.arrays import Array

SIDES = ("medial", "lateral")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosteriorCapsule:
    """The medial and the lateral capsule, stiffnesses of their own and one reference strain.

    Attributes
    ----------
    medial, lateral
        Structures of one line each, whose sites vary or not alike.
    parameters
        Both stiffnesses, the strain, then the shifts of the medial and of the lateral line.
    """

    medial: MissingStructure
    lateral: MissingStructure
    name: str = "posterior_capsule"
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        medial, lateral = self.medial.parameters, self.lateral.parameters
        names = [*(f"{side}_{STIFFNESS}" for side in SIDES), STRAIN]
        if self.sites_vary:
            names += [f"{side}_{shift}" for side in SIDES for shift in SHIFTS]

        def both(medial: Array, lateral: Array) -> list[float]:
            return [medial[0], *lateral[:2], *medial[2:], *lateral[2:]]

        made = amplitudes(
            self.name,
            names,
            both(medial.prior_sd, lateral.prior_sd),
            lower=both(medial.lower, lateral.lower),
            upper=both(medial.upper, lateral.upper),
            center=both(medial.center, lateral.center),
        )
        object.__setattr__(self, "parameters", made)

    @property
    def sites_vary(self) -> bool:
        """Whether the insertions of both lines may be shifted."""
        return self.medial.sites_vary

    @property
    def first_shift(self) -> int:
        """Where the shifts begin among the amplitudes, after the reference strain."""
        return 3

    def change(self, setting: Setting, values: Array) -> Setting:
        """The setting with both lines in place."""
        medial, lateral = self._of_sides(values)
        return self.lateral.change(self.medial.change(setting, medial), lateral)

    def gradient_columns(
        self, setting: Setting, values: Array, flexion: Array, poses: Array
    ) -> Array:
        """Derivatives of the energy's gradient by the amplitudes at fixed poses, ``(n, 5, a)``."""
        medial, lateral = (
            side.gradient_columns(setting, own, flexion, poses)
            for side, own in zip((self.medial, self.lateral), self._of_sides(values), strict=True)
        )
        return np.concatenate(
            [
                medial[:, :, :1],
                lateral[:, :, :1],
                medial[:, :, 1:2] + lateral[:, :, 1:2],
                medial[:, :, 2:],
                lateral[:, :, 2:],
            ],
            axis=2,
        )

    def _of_sides(self, values: Array) -> tuple[Array, Array]:
        """The amplitudes of each structure."""
        medial, lateral = np.split(values[self.first_shift :], 2)
        return np.r_[values[0], values[2], medial], np.r_[values[1], values[2], lateral]
