"""How far what is given with a knee may be from the truth: its insertions, frames, loads."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from identknee.runs.arrays import Array
from identknee.runs.errors import ValueRefused, suggestion

BONES = ("femur", "tibia")
# A standard deviation in mm of every axis, or a covariance in mm^2 along the axes of the bone.
Spread = float | tuple[tuple[float, float, float], ...]
Spreads = Mapping[str, Mapping[str, Spread]]
UncertainLike = str | Sequence[str] | Mapping[str, float] | None
# More than this is not an error of a measurement any more; settings stay where their laws hold.
LARGEST = {"mm": 25.0, "deg": 20.0, "": 1.0}
EXACT = "none"
_SIZE = re.compile(r"\s*([0-9.eE+-]+)\s*(mm|deg|%|)\s*")


def _stated(meaning: str) -> float:
    return field(default=0.0, metadata={"meaning": meaning})


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """Standard deviations of what is given with a knee and its tests; 0 stands for exact.

    Every error is normal with mean zero. The names end in the unit; numbers without one are
    relative, or of a logarithm.

    Attributes
    ----------
    insertions_mm
        Insertions of the ligaments along each axis of their bone: one number for all, or by
        ligament and bone a number or a covariance [mm^2], shape ``(3, 3)``.
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

    Raises
    ------
    ValueError
        If a standard deviation is negative, not finite or larger than any such error.
    """

    insertions_mm: float | Spreads = field(default=0.0, metadata={"meaning": "insertions"})
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

    def __post_init__(self) -> None:
        for name, value in self._values():
            if isinstance(value, Mapping):
                object.__setattr__(self, name, _checked_spreads(value))
            else:
                object.__setattr__(self, name, _checked(name, value))

    @property
    def is_exact(self) -> bool:
        """Whether no uncertainty is stated."""
        return not any(isinstance(x, Mapping) or x > 0.0 for _, x in self._values())

    @property
    def words(self) -> dict[str, str]:
        """What each part was taken for, such as ``2 mm`` or ``exact``, by the name of the part."""
        told: dict[str, str] = {}
        for name, value in self._values():
            if isinstance(value, Mapping):
                stated = sum(len(bones) for bones in value.values())
                told[name] = f"{stated} stated by ligament and bone, the others exact"
            elif value == 0.0:
                told[name] = "exact"
            else:
                sized = f"{value:g} {_unit(name)}".strip()
                told[name] = f"{100.0 * value:g} %" if name == "load_gain" else sized
        return told

    @property
    def sentence(self) -> str:
        """What is treated as uncertain and what as exact."""
        meanings = {x.name: str(x.metadata["meaning"]) for x in fields(self)}
        if self.is_exact:
            return (
                "Geometry, frames, loads and flexion were treated as exact; state their "
                "uncertainty with --uncertain, for example --uncertain insertions=2mm."
            )
        told = [f"{meanings[name]} ({x})" for name, x in self.words.items() if x != "exact"]
        rest = [meanings[name] for name, x in self.words.items() if x == "exact"]
        exact = f" As exact: {', '.join(rest)}." if rest else ""
        return f"Taken as uncertain: {', '.join(told)}.{exact}"

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
                raise ValueError(f"uncertain {name}: there is no such part. {_known(name)}")
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


def _unit(name: str) -> str:
    return next((x for x in ("mm", "deg") if name.endswith(f"_{x}")), "")


def _checked(name: str, value: object) -> float:
    most = LARGEST[_unit(name)]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= most:
        unit = f" {_unit(name)}" if _unit(name) else ""
        raise ValueError(
            f"the uncertainty {name} must be a standard deviation of 0 to {most:g}{unit}, got "
            f"{value!r}"
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
        If not exactly one of both is given, or it is not greater than 0.
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
