"""An effect that extends the model of a subject, as plain data that a file can hold."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from identknee.runs.arrays import Array
from identknee.runs.errors import ValueRefused
from identknee.subject.ligament import Ligament

Points = tuple[Array, Array]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EffectChoice:
    """An effect by name, with the amplitudes found for the subject.

    Attributes
    ----------
    name
        Name of the effect.
    values
        Amplitudes of a right knee, whose z is lateral, by name and in the unit it ends in; those
        left out have the middle of their prior.
    fixed
        Names of amplitudes that are not calibrated.
    lines
        Femoral and tibial point [mm], ``(3,)`` each, of every line of a structure, in the common
        frame of the scanned pose; empty where anatomy places the effect or it has no place.
    stiffness_sd_kN
        Prior standard deviation of a structure's stiffness; its own usual one where None.
    site_sd_mm
        Prior standard deviation of shifts of a structure's points, 0 where they are not shifted;
        the usual one where None.

    Raises
    ------
    ValueError
        If a value is not finite, a line has no length, a standard deviation is out of range, or an
        amplitude is fixed without a value.
    """

    name: str
    values: Mapping[str, float] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()
    lines: tuple[Points, ...] = ()
    stiffness_sd_kN: float | None = None  # noqa: N815 - the key in files
    site_sd_mm: float | None = None

    def __post_init__(self) -> None:
        values = {name: float(value) for name, value in self.values.items()}
        for name, value in values.items():
            if not np.isfinite(value):
                raise ValueError(f"{self.name}.{name} must be finite, got {value:g}")
        for name in self.fixed:
            if name not in values:
                raise ValueRefused(f"{self.name}.{name} is fixed but has no value", "give it one")
        if self.stiffness_sd_kN is not None and not 0.0 < self.stiffness_sd_kN < np.inf:
            raise ValueError(f"stiffness_sd_kN of {self.name} must be greater than 0")
        if self.site_sd_mm is not None and not 0.0 <= self.site_sd_mm < np.inf:
            raise ValueError(f"site_sd_mm of {self.name} must be 0 or greater")
        # A copy rather than a view that cannot be changed: that could not go to other processes.
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "fixed", tuple(self.fixed))
        object.__setattr__(self, "lines", tuple(self._checked(line) for line in self.lines))

    def mirrored(self) -> "EffectChoice":
        """A copy seen in the mirror z = 0; amplitudes are those of a right knee on either side."""
        mirror = np.array([1.0, 1.0, -1.0])
        return replace(self, lines=tuple((x * mirror, y * mirror) for x, y in self.lines))

    def _checked(self, line: Points) -> Points:
        # A line of a structure obeys the rules of a ligament's.
        like = Ligament(
            name=f"a line of {self.name}",
            femur=line[0],
            tibia=line[1],
            stiffness_kN=0.0,
            reference_strain_pct=0.0,
        )
        return like.femur, like.tibia
