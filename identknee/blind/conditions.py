"""Distributions from which blind cases are drawn; each can be replaced."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from identknee.blind.experiment import EXPONENT, Experiment
from identknee.runs.declare import Array, declared, entry
from identknee.subject.knee import EXACTLY, Frame, Knee, UncertainLike, with_stated_uncertainty

# Draws after which a distribution is taken to have hardly any value between its ends.
MOST_TRIES = 1000
SIZES = (
    "jitter_mm",
    "remount_mm",
    "remount_deg",
    "insertion_mm",
    "registration_deg",
    "registration_mm",
    "load_axes_deg",
    "load_gain",
)
# Names of stated errors, and of the fields of `Conditions` that draw them.
STATED = {
    "insertions_mm": "insertion_mm",
    "registration_deg": "registration_deg",
    "registration_mm": "registration_mm",
    "load_axes_deg": "load_axes_deg",
    "load_gain": "load_gain",
    "zero_mm": "remount_mm",
    "zero_deg": "remount_deg",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TruncatedNormal:
    """A truncated normal distribution.

    Attributes
    ----------
    sd
        Standard deviation, > 0.
    center
        Mean.
    lower, upper
        Limits of the values.
    """

    sd: float
    center: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf

    def __post_init__(self) -> None:
        if not 0.0 < self.sd < np.inf:
            raise ValueError(
                f"the standard deviation of a spread must be greater than 0 and finite, got "
                f"{self.sd:g}"
            )
        if not self.lower < self.upper:
            raise ValueError(
                f"the ends of a spread must be lower < upper, got {self.lower:g} and {self.upper:g}"
            )

    def value(self, generator: np.random.Generator) -> float:
        """A random value between the limits."""
        for _ in range(MOST_TRIES):
            drawn = float(generator.normal(self.center, self.sd))
            if self.lower <= drawn <= self.upper:
                return drawn
        raise ValueError(
            f"hardly any value of a normal distribution around {self.center:g} with sd {self.sd:g} "
            f"lies between {self.lower:g} and {self.upper:g}; set the ends farther apart"
        )

    def size(
        self, generator: np.random.Generator, *, n: int = 1, over: float = 1.0, sign: float = 1.0
    ) -> float:
        """Norm of `n` normal values, divided by `over`; `sign` times it is within the limits."""
        for _ in range(MOST_TRIES):
            drawn = self.sd * float(np.linalg.norm(generator.normal(size=n))) / over
            if self.lower <= sign * drawn <= self.upper:
                return drawn
        raise ValueError(
            f"hardly any amplitude of sd {self.sd:g} lies between {self.lower:g} and "
            f"{self.upper:g}; set the ends farther apart"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conditions:
    """The distributions of true parameters, sites, contact and errors of blind cases.

    Without arguments, those of the standard blind test.

    Attributes
    ----------
    stiffness_log_sd
        Standard deviation of the logarithm of the true stiffnesses around the subject's.
    strain_sd_pct
        Standard deviation of the true reference strains around the subject's [%].
    largest_shift_pct
        Largest shift of a reference strain; larger ones are clipped [%].
    most_stiffness_kN, most_strain_pct
        Size above which a true parameter is drawn again.
    amplitudes
        Distribution of the amplitudes of effects by name, if no signal is wanted; other effects
        are sized from the literature.
    structure_strain_pct
        Distribution of the slack strain of structures [%]; uniform from 1 to 5 if None.
    exponents
        Limits of the uniform distribution of the exponent of the contact law.
    jitter_mm
        Standard deviation of each coordinate of a structure's insertions around anatomical sites.
    shift_mm
        Distance of each insertion of a structure from its anatomical site, in a random direction,
        in place of the jitter; None for the jitter.
    remount_mm, remount_deg
        Standard deviation of an error of each coordinate that all trials of a flexion angle share,
        as if the knee was mounted again for each angle.
    insertion_mm
        Standard deviation of each coordinate of the insertions around those given.
    registration_deg, registration_mm
        Standard deviation of turn and shift of each bone's measured frame against the one given.
    load_axes_deg, load_gain
        Standard deviation of the turn of the axes of the loads, and of the scale of each kind.
    """

    stiffness_log_sd: float = 0.2
    strain_sd_pct: float = 1.0
    largest_shift_pct: float = 2.0
    most_stiffness_kN: float = np.inf  # noqa: N815 - the unit
    most_strain_pct: float = np.inf
    amplitudes: Mapping[str, TruncatedNormal] = field(default_factory=dict)
    structure_strain_pct: TruncatedNormal | None = None
    exponents: tuple[float, float] = (EXPONENT, EXPONENT)
    jitter_mm: float = 3.0
    shift_mm: float | None = None
    remount_mm: float = 0.0
    remount_deg: float = 0.0
    insertion_mm: float = 0.0
    registration_deg: float = 0.0
    registration_mm: float = 0.0
    load_axes_deg: float = 0.0
    load_gain: float = 0.0

    def __post_init__(self) -> None:
        low, high = self.exponents
        if not 0.0 < low <= high < np.inf:
            raise ValueError(
                f"the exponents of the contact law must be 0 < low <= high, got {low:g} and "
                f"{high:g}"
            )
        for name in SIZES:
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ValueError(
                    f"{name} must be at least 0 and finite, got {getattr(self, name):g}"
                )

    @property
    def has_stated_errors(self) -> bool:
        """Whether the given geometry or loads have errors."""
        sizes = (self.insertion_mm, self.registration_deg, self.registration_mm)
        return max(*sizes, self.load_axes_deg, self.load_gain) > 0.0

    def place(self, anatomical: Array, generator: np.random.Generator) -> Array:
        """A structure's true place [mm] near its anatomical one, shape ``(3,)``."""
        if self.shift_mm is None:
            return np.asarray(anatomical + generator.normal(0.0, self.jitter_mm, 3))
        way = generator.normal(size=3)
        return np.asarray(anatomical + self.shift_mm * way / np.linalg.norm(way))

    def remounting(self, flexion_deg: Array, generator: np.random.Generator) -> Array:
        """Error of remounting, common to all trials of a flexion angle [mm, deg], ``(n, 5)``."""
        sd = np.repeat([self.remount_mm, self.remount_deg], [3, 2])
        angles, number = np.unique(flexion_deg, return_inverse=True)
        return np.asarray((sd * generator.standard_normal((len(angles), 5)))[number.ravel()])


STANDARD = Conditions()


def stated_conditions(uncertain: UncertainLike) -> Conditions:
    """The standard conditions with errors of the given geometry and loads of the stated size.

    Parameters
    ----------
    uncertain
        Standard deviations as in ``"insertions=2mm,registration=2deg"``; None for exact.

    Raises
    ------
    ValueError
        If an error is stated that the generator cannot draw.

    Examples
    --------
    >>> stated_conditions("insertions=2mm").insertion_mm
    2.0
    """
    stated = with_stated_uncertainty(EXACTLY, uncertain)
    sizes = {x.name: getattr(stated, x.name) for x in fields(stated)}
    for name, size in sizes.items():
        if name not in STATED and size != 0.0:
            raise ValueError(
                f"a blind case takes {name} as exact; state only insertions, registration, "
                "load_axes, load_gain or zero"
            )
    return replace(STANDARD, **{own: sizes[name] for name, own in STATED.items()})


GAINS = tuple(
    f"load_gain.{x}"
    for x in ("varus_moment", "internal_moment", "anterior_force", "axial_force", "lateral_force")
)
# Error [mm, deg or relative] below which it is rounding.
ROUNDING = 1e-9


def knee_with_errors(knee: Knee, conditions: Conditions, generator: np.random.Generator) -> Knee:
    """The knee as it is in the rig, where the one given has errors of the stated size.

    Insertions are shifted, with reference lengths measured between them in the scanned pose. The
    frames of the rig differ from those given; loads, flexion and readings belong to the former.
    """
    shifts = conditions.insertion_mm * generator.standard_normal((len(knee.ligaments), 2, 3))
    femur, tibia = (
        _moved(frame, conditions, generator) for frame in (knee.femur_frame, knee.tibia_frame)
    )
    ligaments = [
        replace(
            ligament,
            femur=ligament.femur + femoral @ knee.femur_frame.axes,
            tibia=ligament.tibia + tibial @ knee.tibia_frame.axes,
        )
        for ligament, (femoral, tibial) in zip(knee.ligaments, shifts, strict=True)
    ]
    return replace(knee, ligaments=tuple(ligaments), femur_frame=femur, tibia_frame=tibia)


@declared
class LoadErrors:
    """Differences between the loads that act and those stated."""

    gains: Array = entry("Scale of each kind of load less 1, shape ``(5,)``")
    turn_deg: Array = entry("Turn of their axes [deg], shape ``(3,)``")


NO_ERRORS = LoadErrors(gains=np.zeros(5), turn_deg=np.zeros(3))


def load_errors(conditions: Conditions, generator: np.random.Generator) -> LoadErrors:
    """Random errors of the loads, of the size in `conditions`."""
    gains = conditions.load_gain * generator.standard_normal(5)
    turn_deg = conditions.load_axes_deg * generator.standard_normal(3)
    return LoadErrors(gains=gains, turn_deg=turn_deg)


def with_load_errors(experiment: Experiment, errors: LoadErrors) -> Experiment:
    """The experiment with loads along turned axes, and each kind scaled by its own gain."""
    turn = Rotation.from_rotvec(np.radians(errors.turn_deg)).as_matrix()
    # Varus about the anterior axis, internal about the superior one; distraction points down.
    loads = experiment.loads * (1.0 + errors.gains)
    moments = np.column_stack([loads[:, 0], loads[:, 1], np.zeros(len(loads))]) @ turn.T
    forces = np.column_stack([loads[:, 2], -loads[:, 3], loads[:, 4]]) @ turn.T
    acting = np.column_stack(
        [moments[:, 0], moments[:, 1], forces[:, 0], -forces[:, 1], forces[:, 2]]
    )
    return replace(experiment, loads=acting)


def true_errors(given: Knee, actual: Knee, loads: LoadErrors) -> dict[str, float]:
    """All errors that are not zero, by the names of the nuisances that stand for them."""
    found: dict[str, Array] = {}
    for before, after in zip(given.ligaments, actual.ligaments, strict=True):
        name = f"insertion.{before.name}"
        found[f"{name}_femur_{{}}_mm"] = given.femur_frame.axes @ (after.femur - before.femur)
        found[f"{name}_tibia_{{}}_mm"] = given.tibia_frame.axes @ (after.tibia - before.tibia)
    frames = {
        "femur": (given.femur_frame, actual.femur_frame),
        "tibia": (given.tibia_frame, actual.tibia_frame),
    }
    for bone, (stated, own) in frames.items():
        turn = Rotation.from_matrix(stated.axes @ own.axes.T).as_rotvec(degrees=True)
        found[f"registration.{bone}_{{}}_deg"] = turn
        found[f"registration.{bone}_{{}}_mm"] = stated.to_local(own.origin)
    found["load_axes.{}_deg"] = loads.turn_deg
    numbers = {
        name.format(axis): float(x)
        for name, values in found.items()
        for axis, x in zip("xyz", values, strict=True)
    }
    numbers |= dict(zip(GAINS, loads.gains.tolist(), strict=True))
    return {name: x for name, x in numbers.items() if abs(x) > ROUNDING}


def _moved(frame: Frame, conditions: Conditions, generator: np.random.Generator) -> Frame:
    turn = np.radians(conditions.registration_deg) * generator.standard_normal(3)
    shift: Array = conditions.registration_mm * generator.standard_normal(3)
    axes = Rotation.from_rotvec(turn).as_matrix().T @ frame.axes
    return Frame(origin=frame.to_common(shift), axes=axes)
