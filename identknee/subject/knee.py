"""The knee of a subject: surfaces, frames, ligaments, stored effects and their uncertainty."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from identknee.runs.declare import (
    CHECK_UNITS,
    Array,
    declared,
    entry,
    frozen,
    implausible_coordinates,
    short_repr,
)
from identknee.runs.errors import ValueRefused, suggestion
from identknee.runs.words import amount, unit_of
from identknee.subject.ligament import Ligament, LigamentGroup, check_groups
from identknee.subject.plausibility import (
    OTHER_NAMES,
    Limits,
    PlausibleLike,
    default_limits,
    plausible_limits,
)
from identknee.subject.surface import Surface

BONES, AXES = ("femur", "tibia"), ("x", "y", "z")
# A standard deviation in mm of every axis, or a covariance in mm^2 along the axes of the bone.
Spread = float | tuple[tuple[float, float, float], ...]
Spreads = Mapping[str, Mapping[str, Spread]]
UncertainLike = str | Sequence[str] | Mapping[str, float] | None
# Largest standard deviations that are accepted, by unit; a measurement has no larger errors.
LARGEST = {"mm": 25.0, "deg": 20.0, "": 1.0}
EXACT = "none"
_SIZE = re.compile(r"\s*([0-9.eE+-]+)\s*(mm|deg|%|)\s*")


def _stated(meaning: str) -> float:
    return field(default=0.0, metadata={"meaning": meaning})


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """Standard deviations of the errors of a knee's geometry and of its tests; 0 stands for exact.

    Every error is normal with mean zero. The names end in the unit; numbers without one are
    relative, or of a logarithm.

    Attributes
    ----------
    insertions_mm
        Insertions of the ligaments along each axis of their bone: one number for all, or by
        ligament and bone a number or a covariance [mm^2], shape ``(3, 3)``.
    insertions_normal_mm
        The same across the surface of the bone, where `insertions_mm` is one number: that is then
        the error along the surface. 0 where it is the same in all directions.
    registration_deg, registration_mm
        Rotation about, and translation along, each axis of each bone's measured frame against the
        frame of its geometry.
    load_axes_deg
        Rotation of the axes along which loads act about each of their own axes.
    load_gain
        Scale of each kind of load, relative.
    flexion_deg
        Offset of flexion, one for all trials.
    trial_flexion_deg
        Error of flexion of each trial by itself.
    contact_modulus, contact_exponent
        Logarithms of the modulus of the cartilage and of the exponent by which its pressure grows
        with depth.
    surface_mm
        Smooth offset of the cartilage sheets.
    zero_mm, zero_deg
        Offset of each coordinate common to all trials of a flexion angle: the knee was mounted
        again.
    reference_pose_deg, reference_pose_mm
        Rotation and translation of the tibia in the pose in which reference lengths were measured.
    toe_region
        Logarithm of the strain at which the ligaments' toe region ends.
    state_drift_mm, state_drift_deg
        Change of each reading from the intact knee to each state in which something was cut.
    state_elongation
        Strain by which testing stretched all ligaments between the intact knee and each such state.
    structures
        Structures of the library that the knee has and the model lacks, such as its capsule: scale
        of the prior of their stiffness, relative to the usual one.

    Raises
    ------
    ValueError
        If a standard deviation is negative, not finite or larger than any such error.
    """

    insertions_mm: float | Spreads = field(default=0.0, metadata={"meaning": "insertions"})
    # Not printed, so that records of knees without it are as they were in earlier versions.
    insertions_normal_mm: float = field(
        default=0.0, repr=False, metadata={"meaning": "insertions across the bone"}
    )
    registration_deg: float = _stated("turn of the measured frames")
    registration_mm: float = _stated("shift of the measured frames")
    load_axes_deg: float = _stated("load axes")
    load_gain: float = _stated("load gain")
    flexion_deg: float = _stated("flexion")
    trial_flexion_deg: float = _stated("flexion of single trials")
    contact_modulus: float = _stated("contact modulus")
    contact_exponent: float = _stated("contact exponent")
    surface_mm: float = _stated("cartilage surfaces")
    zero_mm: float = _stated("zero of lengths")
    zero_deg: float = _stated("zero of angles")
    reference_pose_deg: float = _stated("turn of the scanned pose")
    reference_pose_mm: float = _stated("shift of the scanned pose")
    toe_region: float = _stated("toe region")
    state_drift_mm: float = _stated("drift of lengths between states")
    state_drift_deg: float = _stated("drift of angles between states")
    state_elongation: float = _stated("elongation of ligaments between states")
    # Not printed either.
    structures: float = field(
        default=0.0, repr=False, metadata={"meaning": "structures that the model lacks"}
    )

    def __post_init__(self) -> None:
        for name, value in self._values():
            if isinstance(value, Mapping):
                object.__setattr__(self, name, _checked_spreads(value))
            else:
                object.__setattr__(self, name, _checked(name, value))
        if self.insertions_normal_mm and not (
            isinstance(self.insertions_mm, float) and self.insertions_mm > 0.0
        ):
            raise ValueRefused(
                "insertions_normal_mm is the error across the bone beside one along it",
                "state insertions too, as in insertions=4mm,insertions_normal=1mm",
            )

    @property
    def is_exact(self) -> bool:
        """Whether no uncertainty is stated."""
        return not any(isinstance(x, Mapping) or x > 0.0 for _, x in self._values())

    @property
    def words(self) -> dict[str, str]:
        """Standard deviation of each part in words, such as ``2 mm`` or ``exact``, by its name."""
        found: dict[str, str] = {}
        for name, value in self._values():
            if isinstance(value, Mapping):
                stated = sum(len(bones) for bones in value.values())
                found[name] = f"{stated} stated by ligament and bone, the others exact"
            elif value == 0.0:
                # Insertions are as well known across the bone as along it, if nothing is stated.
                if name not in ("insertions_normal_mm", "structures"):
                    found[name] = "exact"
            else:
                sized = f"{value:g} {unit_of(name)}".strip()
                is_share = name in ("load_gain", "structures")
                found[name] = f"{100.0 * value:g} %" if is_share else sized
        return found

    @property
    def sentence(self) -> str:
        """What is treated as uncertain and what as exact."""
        meanings = {x.name: str(x.metadata["meaning"]) for x in fields(self)}
        if self.is_exact:
            return (
                "Geometry, frames, loads and flexion were treated as exact; state their "
                "uncertainty with --uncertain, for example --uncertain insertions=2mm."
            )
        uncertain = [f"{meanings[name]} ({x})" for name, x in self.words.items() if x != "exact"]
        # What changes between states means nothing where there is one alone.
        rest = [
            meanings[name]
            for name, x in self.words.items()
            if x == "exact" and not name.startswith("state_")
        ]
        exact = f" As exact: {', '.join(rest)}." if rest else ""
        return f"Taken as uncertain: {', '.join(uncertain)}.{exact}"

    def insertion_covariance(self, ligament: str, bone: str) -> Array:
        """Covariance of an insertion along the axes of its bone [mm^2], shape ``(3, 3)``."""
        spread: Spread | float = 0.0
        if isinstance(self.insertions_mm, Mapping):
            spread = self.insertions_mm.get(ligament, {}).get(bone, 0.0)
        else:
            spread = self.insertions_mm
        if isinstance(spread, tuple):
            return np.array(spread)
        return float(spread) ** 2 * np.eye(3)

    def check_ligaments(self, names: Sequence[str]) -> None:
        """Refuse insertions of a ligament that the knee does not have.

        Raises
        ------
        ValueError
            Naming the first.
        """
        stated = self.insertions_mm if isinstance(self.insertions_mm, Mapping) else {}
        for name in stated:
            if name not in names:
                raise ValueError(
                    f"the uncertainty of insertions names the ligament {name!r}, which the knee "
                    f"does not have. {suggestion(name, names)}"
                )

    def _values(self) -> list[tuple[str, float | Spreads]]:
        return [(x.name, getattr(self, x.name)) for x in fields(self)]


def with_stated_uncertainty(own: Uncertainty, stated: UncertainLike) -> Uncertainty:
    """The uncertainty of a subject with other parts stated in place of its own.

    Parameters
    ----------
    own
        What the subject states.
    stated
        Texts such as ``"insertions=2mm,registration=2deg"``, or numbers by name such as
        ``{"insertions_mm": 2.0}``; ``"none"`` for a knee known exactly. None changes nothing.

    Raises
    ------
    ValueError
        If a name or a unit is not known, or a size is out of range.

    Examples
    --------
    >>> with_stated_uncertainty(Uncertainty(), "insertions=2mm,load_gain=3%").words["load_gain"]
    '3 %'
    """
    if stated is None:
        return own
    if isinstance(stated, Mapping):
        known = [x.name for x in fields(Uncertainty)]
        for name in stated:
            if name not in known:
                meant = suggestion(name, known)
                raise ValueError(f"uncertain {name}: there is no such part. {meant}")
        return replace(own, **stated)
    texts = [stated] if isinstance(stated, str) else list(stated)
    parts = [x.strip() for text in texts for x in text.split(",") if x.strip()]
    if isinstance(stated, str) and not parts:
        raise ValueError("--uncertain is empty; write for example --uncertain insertions=2mm")
    for part in parts:
        own = EXACTLY if part == EXACT else replace(own, **_one(part))
    return own


def _one(text: str) -> dict[str, float]:
    name, equals, size = (x.strip() for x in text.partition("="))
    found = _SIZE.fullmatch(size)
    try:
        number = math.nan if found is None else float(found[1])
    except ValueError:
        number = math.nan
    if not equals or found is None or math.isnan(number):
        raise ValueError(
            f"--uncertain {text}: this is not NAME=SIZE; write for example "
            "--uncertain insertions=2mm,registration=2deg"
        )
    unit = found[2]
    whole = f"{name}_{unit}" if unit in ("mm", "deg") else name
    known = [x.name for x in fields(Uncertainty)]
    if whole in known:
        return {whole: number / 100.0 if unit == "%" else number}
    units = [x.rpartition("_")[2] for x in known if x in (f"{name}_mm", f"{name}_deg")]
    if units:
        written = " or ".join(f"{name}={found[1]}{x}" for x in units)
        why = f"{name} is stated in {' or '.join(units)}; write {written}"
    elif name in known:
        why = f"{name} has no unit; write {name}=0.1 or {name}=10%"
    else:
        why = f"there is no such part. {_known(name)}"
    raise ValueError(f"--uncertain {text}: {why}")


def _known(name: str) -> str:
    parts = dict.fromkeys(re.sub("_(mm|deg)$", "", x.name) for x in fields(Uncertainty))
    return suggestion(name, list(parts))


def _checked(name: str, value: object) -> float:
    unit = unit_of(name)
    most = LARGEST[unit]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= most:
        if name == "structures":
            raise ValueError(
                f"the uncertainty {name} must be a share of the usual scale, 0 to 1 or 0 to 100 %, "
                f"got {value!r}; write {name}=50%, in subject.toml {name} = 0.5"
            )
        raise ValueError(
            f"the uncertainty {name} must be a standard deviation of 0 to {amount(most, unit)}, "
            f"got {value!r}"
        )
    return float(value)


def _checked_spreads(value: Spreads) -> dict[str, dict[str, Spread]]:
    """Spreads by ligament and bone as plain numbers."""
    checked: dict[str, dict[str, Spread]] = {}
    for ligament, bones in value.items():
        if not set(bones) <= set(BONES):
            why = f"the uncertainty of the insertions of {ligament} must be given by bone"
            raise ValueRefused(why, "write for example { femur = 2.0, tibia = 3.0 }")
        checked[ligament] = {
            bone: _checked_spread(f"insertions_mm of {ligament} on the {bone}", x)
            for bone, x in bones.items()
        }
    return checked


def _checked_spread(where: str, value: object) -> Spread:
    if isinstance(value, int | float):
        return _checked(f"{where}_mm", value)
    matrix = np.array(value, float)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ValueError(f"{where} must be one number or a covariance of 3 by 3 numbers in mm^2")
    if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix).min() < 0.0:
        raise ValueError(f"{where}: the covariance must be symmetric with no negative eigenvalue")
    return tuple(tuple(row) for row in matrix.tolist())


EXACTLY = Uncertainty()


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedPrior:
    """A stated prior of a parameter.

    Attributes
    ----------
    sd
        Standard deviation in the parameter's unit, of a normal prior; None for a lognormal one.
    log_sd
        Standard deviation of the natural logarithm, of a lognormal prior; None for a normal one.
    center
        Middle of the prior in the parameter's unit; the subject's own value where None.

    Raises
    ------
    ValueError
        If not exactly one of `sd` and `log_sd` is given, or it is not greater than 0.
    """

    sd: float | None = None
    log_sd: float | None = None
    center: float | None = None

    def __post_init__(self) -> None:
        if (self.sd is None) == (self.log_sd is None):
            raise ValueRefused("a prior has either sd or log_sd", "give one of the two")
        if not 0.0 < self.spread < float("inf"):
            raise ValueError(f"the spread of a prior must be greater than 0, got {self.spread:g}")
        if self.is_log and self.center is not None and not self.center > 0.0:
            raise ValueError(
                f"the centre of a lognormal prior must be greater than 0, got {self.center:g}"
            )

    @property
    def is_log(self) -> bool:
        """Whether it is lognormal."""
        return self.log_sd is not None

    @property
    def spread(self) -> float:
        """The standard deviation that was given."""
        return float((self.sd if self.log_sd is None else self.log_sd) or 0.0)


# Largest error of orthonormal axes written with three decimals; sheared or scaled frames exceed it.
ROUNDING = 2e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """A right-handed frame of a bone in the common frame of the scanned pose.

    Attributes
    ----------
    origin
        Position [mm], shape ``(3,)``.
    axes
        Unit vectors as rows: anterior, superior, lateral; shape ``(3, 3)``. Rows rounded in a file
        are squared up to the nearest rotation.

    Raises
    ------
    ValueError
        If a value is not finite, or the axes are not orthonormal or not right-handed.
    """

    origin: Array
    axes: Array

    def __post_init__(self) -> None:
        origin = frozen(self.origin, 3, name="the origin of a frame")
        axes = frozen(self.axes, 3, 3, name="the axes of a frame")
        if not (np.isfinite(origin).all() and np.isfinite(axes).all()):
            raise ValueError("the origin and axes of a frame must be finite numbers")
        if far := implausible_coordinates(origin):
            raise ValueRefused(f"the origin of a frame lies {far}", CHECK_UNITS)
        # Products of larger numbers may overflow.
        error = (
            np.inf if np.abs(axes).max() > 2.0 else float(np.abs(axes @ axes.T - np.eye(3)).max())
        )
        if error > ROUNDING:
            raise ValueRefused(
                "the axes of a frame must be unit vectors at right angles, one a row, but their "
                f"products are off by {error:.2g}",
                "normalise them",
            )
        if np.linalg.det(axes) < 0.0:
            why = "the axes of a frame must be right-handed: x anterior, y superior, z to the right"
            raise ValueRefused(why, "turn one of them round")
        if error > 1e-12:
            left, _, right = np.linalg.svd(axes)
            axes = frozen(left @ right, 3, 3, name="the axes of a frame")
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "axes", axes)

    def to_local(self, points: ArrayLike) -> Array:
        """Points ``(..., 3)`` of the common frame in this frame [mm]."""
        return np.asarray((np.asarray(points, float) - self.origin) @ self.axes.T)

    def to_common(self, points: ArrayLike) -> Array:
        """Points ``(..., 3)`` of this frame in the common frame [mm]."""
        return np.asarray(np.asarray(points, float) @ self.axes + self.origin)

    def mirrored(self) -> "Frame":
        """The frame seen in the mirror z = 0, its third axis turned round to be lateral again."""
        mirror = np.array([1.0, 1.0, -1.0])
        return Frame(origin=self.origin * mirror, axes=mirror[:, None] * self.axes * mirror)


def joint_centre(landmarks: Mapping[str, Array]) -> Array | None:
    """Midpoint of the epicondyles [mm], shape ``(3,)``; None where they are not given."""
    return _midpoint(landmarks, "medial_epicondyle", "lateral_epicondyle")


def ankle_centre(landmarks: Mapping[str, Array]) -> Array | None:
    """The ankle centre, or the midpoint of the malleoli [mm], ``(3,)``; None without either."""
    if "ankle_centre" in landmarks:
        return landmarks["ankle_centre"]
    return _midpoint(landmarks, "medial_malleolus", "lateral_malleolus")


def frames_from_landmarks(
    landmarks: Mapping[str, Array], *, is_left: bool = False
) -> tuple[Frame, Frame]:
    """The frames of femur and tibia that landmarks define.

    Both origins are the midpoint of the epicondyles. The femur's y axis points from there to the
    hip centre, the tibia's from the ankle centre to there; both z axes lie in the plane that y
    spans with the line through the epicondyles and point to the subject's right.

    Parameters
    ----------
    landmarks
        Positions in the common frame [mm], shape ``(3,)``, by their names in a subject's file; the
        ankle is given by its centre or by both malleoli.
    is_left
        Whether this is a left knee, whose lateral side is on the left.

    Raises
    ------
    ValueError
        If a landmark is missing or two of them nearly coincide.
    """
    centre, ankle = joint_centre(landmarks), ankle_centre(landmarks)
    hip = landmarks.get("hip_centre")
    if centre is None or ankle is None or hip is None:
        raise ValueRefused(
            f"the landmarks given ({', '.join(landmarks) or 'none'}) define no frames",
            "give hip_centre, medial_epicondyle, lateral_epicondyle and either ankle_centre or "
            "both malleoli, or the frames themselves",
        )
    across = landmarks["lateral_epicondyle"] - landmarks["medial_epicondyle"]
    right = -across if is_left else across
    return _frame(centre, hip - centre, right), _frame(centre, centre - ankle, right)


def angle_between(one: Array, other: Array) -> float:
    """Angle between two vectors [deg].

    Examples
    --------
    >>> round(angle_between(np.array([1.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0])), 6)
    90.0
    """
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def _midpoint(landmarks: Mapping[str, Array], one: str, other: str) -> Array | None:
    if one in landmarks and other in landmarks:
        return np.asarray((landmarks[one] + landmarks[other]) / 2.0)
    return None


def _frame(origin: Array, up: Array, right: Array) -> Frame:
    length = np.linalg.norm(up)
    if length == 0.0 or np.linalg.norm(np.cross(up, right)) <= 0.1 * length * np.linalg.norm(right):
        raise ValueRefused(
            "the landmarks define no frame: the epicondyles coincide or lie on the long axis of "
            "the bone",
            "check their coordinates",
        )
    superior = up / length
    lateral = right - (right @ superior) * superior
    lateral = lateral / np.linalg.norm(lateral)
    return Frame(origin=origin, axes=np.array([np.cross(superior, lateral), superior, lateral]))


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
        # A line of a structure obeys the rules of a ligament's.
        like = [
            Ligament(
                name=f"a line of {self.name}",
                femur=femur,
                tibia=tibia,
                stiffness_kN=0.0,
                reference_strain_pct=0.0,
            )
            for femur, tibia in self.lines
        ]
        object.__setattr__(self, "lines", tuple((x.femur, x.tibia) for x in like))

    def mirrored(self) -> "EffectChoice":
        """A copy seen in the mirror z = 0; amplitudes are those of a right knee on either side."""
        mirror = np.array([1.0, 1.0, -1.0])
        return replace(self, lines=tuple((x * mirror, y * mirror) for x, y in self.lines))


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

    Interpolated linearly, and constant beyond the first and the last of them.

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
OLDEST = 120.0


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
    bones
        Outer surfaces of femur and tibia, on which insertions lie; None if unknown.
    limits
        Limits of what the knee does that the subject states; they count where they are asked for.
    plausibility
        Limits that count as evidence in fits: see `with_plausibility`.
    donor_age
        Age of the donor [years]; None if unknown. The usual limits depend on it.
    fitted
        Parameters by name at which the knee was fitted: a search starts there.
    contact_rounding_mm
        Rounding of the contact law with which it was fitted, 0 to 0.15: where geometry is
        uncertain, contact begins gradually. See `identknee.mechanics.distance_field.ContactLaw`.
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
    bones: tuple[Surface, Surface] | None = None
    limits: Limits = ()
    plausibility: Limits = ()
    donor_age: float | None = None
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
        if self.donor_age is not None and not 0.0 < self.donor_age < OLDEST:
            raise ValueRefused(
                f"donor_age must be 0 to {OLDEST:g} years, got {self.donor_age:g}",
                "leave it out if it is unknown",
            )
        self.uncertainty.check_ligaments(ligaments)
        check_groups(self.groups, self.ligaments)
        for kept in ("tibia", "ligaments", "landmarks", "effects", "groups", "poses", "limits"):
            object.__setattr__(self, kept, tuple(getattr(self, kept)))

    @property
    def reference_lengths(self) -> Array:
        """Length of each ligament in the scanned pose [mm], ``(n_ligaments,)``."""
        return np.array([x.length for x in self.ligaments])

    @property
    def owners(self) -> list[str]:
        """Group of each ligament, or its own name where it is in none."""
        group_of = {member: group.name for group in self.groups for member in group.members}
        return [group_of.get(x.name, x.name) for x in self.ligaments]

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

    def with_plausibility(self, asked: PlausibleLike) -> "Knee":
        """A copy in which limits count as evidence.

        Parameters
        ----------
        asked
            ``"default"`` for the limits that the subject states, or the usual ones where it states
            none; ``"none"`` for none; a file; or the limits themselves. As they are if None.

        Raises
        ------
        ValueError
            If they cannot be read.
        """
        if asked is None:
            return self
        usual = default_limits([x.name for x in self.ligaments], self.donor_age)
        return replace(self, plausibility=plausible_limits(asked, self.limits or usual))

    @property
    def counted_limits(self) -> Limits:
        """Its limits but for those of structures that it does not have, known or unknown."""
        own = {*(x.name for x in self.ligaments), *(x.name for x in self.effects)}
        return tuple(
            x
            for x in self.plausibility
            if x.owner not in OTHER_NAMES or x.owner in own or self.uncertainty.structures
        )

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
            bones=None
            if self.bones is None
            else (self.bones[0].mirrored(), self.bones[1].mirrored()),
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
