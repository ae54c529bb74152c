"""The knee: surfaces, ligaments and frames of one subject."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from identknee.runs.arrays import Array, frozen, short_repr
from identknee.runs.declare import declared, entry
from identknee.runs.errors import ValueRefused
from identknee.subject.effect_choice import EffectChoice
from identknee.subject.frames import Frame
from identknee.subject.ligament import Ligament, LigamentGroup, check_groups
from identknee.subject.surface import Surface
from identknee.subject.uncertainty import EXACTLY, StatedPrior, Uncertainty

# Coordinates of a laxity table: lateral shift, anterior drawer, distraction, varus, internal.
N_COORDINATES = 5


@declared
class KnownPose:
    """Coordinates of the tibia at a flexion angle, between the frames in which tests are read.

    Raises
    ------
    ValueError
        If a number is not finite or there are not five coordinates.
    """

    flexion_deg: float = entry("Flexion")
    coordinates: Array = entry(
        "Lateral shift, anterior drawer, distraction [mm], varus, internal rotation [deg], shape "
        "``(5,)``"
    )

    def __post_init__(self) -> None:
        place = frozen(self.coordinates, N_COORDINATES, name="the coordinates of a pose")
        if not np.isfinite([self.flexion_deg, *place]).all():
            raise ValueError(
                f"a pose must be finite numbers, got {place.tolist()} at {self.flexion_deg:g} deg"
            )
        object.__setattr__(self, "coordinates", place)


def pose_at(poses: Sequence[KnownPose], flexion_deg: Array) -> Array:
    """Coordinates between the known poses at flexion angles (n,), shape ``(n, 5)``.

    On straight lines from one to the next, and as in the last one beyond it.

    Examples
    --------
    >>> pose = [KnownPose(flexion_deg=x, coordinates=np.full(5, x)) for x in (0.0, 30.0)]
    >>> pose_at(pose, np.array([15.0, 90.0]))[:, 0].tolist()
    [15.0, 30.0]
    """
    ordered = sorted(poses, key=lambda x: x.flexion_deg)
    angles = [x.flexion_deg for x in ordered]
    known = np.array([x.coordinates for x in ordered])
    return np.column_stack([np.interp(flexion_deg, angles, column) for column in known.T])


Side = Literal["right", "left"]
# mm: what the distance field allows for.
MOST_CONTACT_ROUNDING = 0.15


@declared
class Landmark:
    """A named place on a bone."""

    name: str = entry('Name of the place, such as ``"hip_centre"``')
    position: Array = entry("Place in the common frame of the scanned pose [mm], shape ``(3,)``")

    def __post_init__(self) -> None:
        place = frozen(self.position, 3, name=f"the landmark {self.name}")
        if not np.isfinite(place).all():
            raise ValueError(
                f"the landmark {self.name} must be finite numbers in mm, got {place.tolist()}"
            )
        object.__setattr__(self, "position", place)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Knee:
    """A subject's knee in the common frame of its scanned pose.

    Everything here describes a right knee: a left one is mirrored when it is read.

    Attributes
    ----------
    name, description
        What the subject is called, and a sentence about it.
    side
        The side the subject's data came from.
    femur
        Articular surface of the femur.
    tibia
        Articular surfaces of the medial and the lateral plateau.
    ligaments
        Any number, each with its own name.
    femur_frame, tibia_frame
        The bones' frames, moved along with them by the scanner.
    landmarks
        Places the frames were made from or are checked against.
    effects
        Physical effects that extend the model of this subject, in the order in which they act.
    uncertainty
        How well all this is known; what is not stated counts as exact.
    priors, bounds
        Priors and bounds of parameters by name, in place of the usual ones.
    groups
        Ligaments whose parameters are tied.
    poses
        Where the knee is known to be, so that searches for equilibria begin there.
    fitted
        Parameters by name at which the knee was fitted: a search starts there.
    contact_rounding_mm
        Rounding of the contact law with which it was fitted, 0 to 0.15: where geometry is
        uncertain, contact begins gradually. See `identknee.mechanics.contact_law.ContactLaw`.
    femur_distance
        Signed distance [mm] of points ``(n, 3)`` to the femur, negative inside, where a closed form
        of it is known.

    Raises
    ------
    ValueError
        If the side is unknown, there are not two tibial surfaces, or two ligaments or effects share
        a name.
    """

    name: str
    side: Side
    femur: Surface
    tibia: tuple[Surface, ...]
    ligaments: tuple[Ligament, ...]
    femur_frame: Frame
    tibia_frame: Frame
    description: str = ""
    landmarks: tuple[Landmark, ...] = ()
    effects: tuple[EffectChoice, ...] = ()
    uncertainty: Uncertainty = EXACTLY
    priors: Mapping[str, StatedPrior] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    groups: tuple[LigamentGroup, ...] = ()
    poses: tuple[KnownPose, ...] = ()
    fitted: Mapping[str, float] = field(default_factory=dict)
    contact_rounding_mm: float = 0.0
    femur_distance: Callable[[Array], Array] | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        if self.side not in ("right", "left"):
            raise ValueError(f'side must be "right" or "left", got {self.side!r}')
        if len(self.tibia) != 2:
            raise ValueError(
                f"a knee has a medial and a lateral tibial surface, got {len(self.tibia)}"
            )
        ligaments = [x.name for x in self.ligaments]
        names = [*ligaments, *(x.name for x in self.effects)]
        for name in names:
            if names.count(name) > 1:
                kind = "ligaments" if ligaments.count(name) > 1 else "ligaments or effects"
                raise ValueRefused(f"two {kind} are called {name}", "rename one of them")
        if not 0.0 <= self.contact_rounding_mm <= MOST_CONTACT_ROUNDING:
            raise ValueRefused(
                f"contact_rounding_mm must be 0 to {MOST_CONTACT_ROUNDING:g} mm, got "
                f"{self.contact_rounding_mm:g}",
                "leave it out for the law without rounding",
            )
        self.uncertainty.check_ligaments(ligaments)
        check_groups(self.groups, self.ligaments)
        for kept in ("tibia", "ligaments", "landmarks", "effects", "groups", "poses"):
            object.__setattr__(self, kept, tuple(getattr(self, kept)))

    @property
    def reference_lengths(self) -> Array:
        """Distance of each ligament's insertions in the scanned pose [mm], ``(n_ligaments,)``."""
        return np.array([x.length for x in self.ligaments])

    def ligament(self, name: str) -> Ligament:
        """The ligament called `name`.

        Raises
        ------
        ValueError
            If there is none.
        """
        for ligament in self.ligaments:
            if ligament.name == name:
                return ligament
        known = ", ".join(x.name for x in self.ligaments)
        raise ValueError(f"there is no ligament {name!r}; the ligaments are {known}")

    def with_ligaments(self, ligaments: Sequence[Ligament]) -> "Knee":
        """A copy with other ligaments."""
        return replace(self, ligaments=tuple(ligaments))

    def with_effects(self, effects: Sequence[EffectChoice]) -> "Knee":
        """A copy with other effects."""
        return replace(self, effects=tuple(effects))

    def with_uncertainty(self, uncertainty: Uncertainty) -> "Knee":
        """A copy with another stated uncertainty."""
        return replace(self, uncertainty=uncertainty)

    def in_scan_frame(self, points: Array) -> Array:
        """Points of the common frame [mm], shape ``(..., 3)``, where the scan has them, or back.

        Those of a left knee are mirrored; those of a right one stay where they are.
        """
        return np.asarray(points * [1.0, 1.0, -1.0 if self.side == "left" else 1.0])

    def mirrored(self) -> "Knee":
        """The knee seen in the mirror z = 0, its frames turned so that z is lateral again.

        The same knee in every angle and distance; reading and writing left knees uses it.
        """
        distance = self.femur_distance
        return replace(
            self,
            femur=self.femur.mirrored(),
            tibia=tuple(x.mirrored() for x in self.tibia),
            ligaments=tuple(x.mirrored() for x in self.ligaments),
            femur_frame=self.femur_frame.mirrored(),
            tibia_frame=self.tibia_frame.mirrored(),
            landmarks=tuple(
                Landmark(name=x.name, position=x.position * [1.0, 1.0, -1.0])
                for x in self.landmarks
            ),
            effects=tuple(x.mirrored() for x in self.effects),
            femur_distance=None if distance is None else _Mirrored(distance=distance),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Mirrored:
    """A distance function seen in the mirror z = 0."""

    distance: Callable[[Array], Array]

    def __call__(self, points: Array) -> Array:
        return self.distance(points * [1.0, 1.0, -1.0])
