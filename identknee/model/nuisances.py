"""Nuisance parameters: stated errors of geometry, registration and loads.

Insertions are known along the surface of a bone and across it.
"""

from collections.abc import Callable, Sequence
from dataclasses import field, replace
from functools import partial
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from identknee.laxity.forces import WRENCH
from identknee.laxity.table import COORDINATES
from identknee.mechanics.distance_field import MOST_ROUNDING
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.model.effects.effect import (
    Changed,
    Effect,
    InputsChange,
    ReadingError,
    TrialRecord,
    amplitudes,
    with_fixed_amplitudes,
)
from identknee.model.effects.library import effects_of, structures_lacking
from identknee.model.effects.loads import INTERNAL, VARUS, LoadError, X, Y, Z
from identknee.model.effects.readings import flexion_offset
from identknee.model.effects.tissues import insertion
from identknee.model.mechanics_inputs import PER_PCT, MechanicsInputs, frames_at, placements
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, declared, entry
from identknee.runs.errors import ValueRefused
from identknee.subject.knee import AXES, BONES, Knee
from identknee.subject.surface import Surface

# Radius of the patch over which a surface normal is averaged, about the size of an insertion [mm].
PATCH_MM = 5.0


def surface_normal(surface: Surface, place: Array) -> Array:
    """Unit normal of a surface near a place, shape ``(3,)``.

    The mean over triangles within 5 mm of the nearest one, weighted by their areas.

    Parameters
    ----------
    surface
        The surface of a bone.
    place
        A point near it [mm], shape ``(3,)``.
    """
    middles = surface.vertices[surface.faces].mean(axis=1)
    tree = cKDTree(middles)
    nearest = middles[int(tree.query(place)[1])]
    near = tree.query_ball_point(nearest, PATCH_MM)
    normal = surface.areas[near] @ surface.normals[near]
    return np.asarray(normal / np.linalg.norm(normal))


def insertion_covariance(knee: Knee, ligament: str, bone: str) -> Array:
    """Covariance of an insertion along the axes of its bone [mm^2], shape ``(3, 3)``.

    If its uncertainty across the surface of the bone is stated apart from that along it, one
    principal axis is the normal of that surface.

    Raises
    ------
    ValueError
        If an uncertainty across the bone is stated and the knee has no surfaces of the bones.
    """
    stated = knee.uncertainty
    if not stated.insertions_normal_mm:
        return stated.insertion_covariance(ligament, bone)
    if knee.bones is None:
        raise ValueRefused(
            f"insertions across the bone are uncertain by {stated.insertions_normal_mm:g} mm, and "
            f"{knee.name} has no surfaces of the bones",
            "add femur_bone and tibia_bone to [surfaces], or state one size for all directions",
        )
    i = BONES.index(bone)
    frame = (knee.femur_frame, knee.tibia_frame)[i]
    normal = frame.axes @ surface_normal(knee.bones[i], getattr(knee.ligament(ligament), bone))
    across = np.outer(normal, normal)
    along = stated.insertion_covariance(ligament, bone)[0, 0]
    return np.asarray(along * (np.eye(3) - across) + stated.insertions_normal_mm**2 * across)


# Bounds of an amplitude, in prior standard deviations.
REACH = 4.0
CELL = "load_cell"
KINDS = ("varus_moment", "internal_moment", "anterior_force", "axial_force", "lateral_force")
MOMENTS, FORCES = [VARUS, INTERNAL], [X, Y, Z]


def stated_errors(cause: str, names: Sequence[str], sds: Sequence[float]) -> Parameters:
    """Nuisance parameters ``cause.name`` with these prior standard deviations, 0 for none."""
    used = {name: sd for name, sd in zip(names, sds, strict=True) if sd > 0.0}
    farthest = [REACH * x for x in used.values()]
    return amplitudes(cause, [*used], [*used.values()], upper=farthest).as_nuisances()


def load_axes(sd_deg: float) -> LoadError:
    """Loads along axes that are turned about the joint's x, y and z [deg]."""
    made = stated_errors("load_axes", [f"{x}_deg" for x in AXES], 3 * [sd_deg])
    return LoadError(name="load_axes", parameters=made, acted=_turned)


def load_gain(sd: float) -> LoadError:
    """A wrong scale of each kind of load [-]."""
    made = stated_errors("load_gain", KINDS, 5 * [sd])
    return LoadError(name="load_gain", parameters=made, acted=_scaled)


def load_cell(sd_N: float, sd_Nm: float) -> ReadingError:
    """A constant error of what a load cell reads in superposition, along tibial axes [N, N m].

    It remains of drift between two runs and of the compensation of gravity. Coordinates do not
    change with it.
    """
    made = stated_errors(CELL, WRENCH, [sd_N] * 3 + [sd_Nm] * 3)
    return ReadingError(name=CELL, parameters=made, read=_unchanged)


def _unchanged(coordinates: Array, _values: Array, _tests: TrialRecord) -> Array:
    return coordinates


def flexion(sd_deg: float) -> InputsChange:
    """An error of flexion in all trials, positive where the knee was flexed more [deg]."""
    made = stated_errors("flexion", ["offset_deg"], [sd_deg])
    return replace(flexion_offset(), name="flexion", parameters=made)


def _turned(loads: Array, _flexion: Array, values: Array) -> Array:
    # Loaded late: it takes longer than a simulation.
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(np.radians(values))
    moments = np.column_stack([loads[:, MOMENTS], np.zeros(len(loads))])
    acted = np.array(loads)
    # The rig prescribes flexion, and so takes up any moment about that axis.
    acted[:, MOMENTS] = turn.apply(moments)[:, :2]
    acted[:, FORCES] = turn.apply(loads[:, FORCES])
    return acted


def _scaled(loads: Array, _flexion: Array, values: Array) -> Array:
    return loads * (1.0 + values)


@declared
class LinearlyCombinedEffect:
    """An effect on the setting at amplitudes ``matrix @ values``."""

    effect: InputsChange = entry("The effect, of n amplitudes")
    matrix: Array = entry("Shape ``(n, k)``")
    parameters: Parameters = entry("The k amplitudes that are combined")
    differs_by_replica: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """Name of the cause."""
        return self.effect.name

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the effect."""
        return self.effect.change(setting, values @ self.matrix.T)


# Largest error of an insertion [mm].
FARTHEST = 25.0
PRINCIPAL_AXES = ("1st", "2nd", "3rd")


def insertions(knee: Knee) -> LinearlyCombinedEffect:
    """Shifts of the uncertain insertions [mm].

    Along the axes of the bone, or along the principal axes of a covariance that is not the same
    along all of them.
    """
    shifts = insertion(knee)
    columns: list[Array] = []
    names: list[str] = []
    sds: list[float] = []
    places = [(x.name, bone) for x in knee.ligaments for bone in BONES]
    for place, (ligament, bone) in enumerate(places):
        covariance = insertion_covariance(knee, ligament, bone)
        is_diagonal = np.array_equal(covariance, np.diag(np.diag(covariance)))
        squares, directions = (
            (np.diag(covariance), np.eye(3)) if is_diagonal else np.linalg.eigh(covariance)
        )
        axes = AXES if is_diagonal else PRINCIPAL_AXES
        for square, direction, axis in zip(squares, directions.T, axes, strict=True):
            if square > 0.0:
                column = np.zeros(shifts.parameters.n)
                column[3 * place : 3 * place + 3] = direction
                columns.append(column)
                names.append(f"{ligament}_{bone}_{axis}_mm")
                sds.append(float(np.sqrt(square)))
    limits = [min(REACH * x, FARTHEST) for x in sds]
    made = amplitudes(shifts.name, names, sds, upper=limits)
    return LinearlyCombinedEffect(
        effect=shifts, matrix=np.column_stack(columns), parameters=made.as_nuisances()
    )


def _one_error(name: str, amplitude: str, sd: float, changed: Changed) -> InputsChange:
    made = stated_errors(name, [amplitude], [sd])
    return InputsChange(name=name, parameters=made, changed=changed)


def contact_modulus(sd: float) -> InputsChange:
    """Logarithm of the modulus of the cartilage over the knee's own."""
    return _one_error("contact_modulus", "ln_modulus", sd, partial(_with_law, "modulus"))


def contact_exponent(sd: float) -> InputsChange:
    """Logarithm of the exponent by which contact pressure grows with depth, over the knee's own."""
    return _one_error("contact_exponent", "ln_exponent", sd, partial(_with_law, "exponent"))


def toe_region(sd: float) -> InputsChange:
    """Logarithm of the strain at which all ligaments' toe region ends, over the knee's own."""
    return _one_error("toe_region", "ln_strain", sd, _with_toe_region)


def state_drift(sd_mm: float, sd_deg: float) -> ReadingError:
    """Change of each reading between the intact knee and a state with a cut [mm, deg]."""
    sds = [sd_mm if x.endswith("_mm") else sd_deg for x in COORDINATES]
    made = stated_errors("state_drift", COORDINATES, sds)
    read = partial(_with_state_drift, tuple(np.flatnonzero(sds).tolist()))
    return ReadingError(name="state_drift", parameters=made, read=read)


def state_elongation(sd: float) -> InputsChange:
    """Strain by which testing stretched all ligaments before a state with a cut [%]."""
    return _one_error("state_elongation", "strain_pct", 100.0 * sd, _with_elongation)


def _with_state_drift(
    used: tuple[int, ...], coordinates: Array, values: Array, _tests: TrialRecord
) -> Array:
    read = np.array(coordinates)
    read[:, list(used)] += values
    return read


def _with_elongation(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    change = np.where(setting.owner >= 0, PER_PCT * values[0], 0.0)
    return replace(setting, reference_strain=setting.reference_strain - change)


def reference_pose(sd_deg: float, sd_mm: float) -> InputsChange:
    """Turn [deg] and shift [mm] of the tibia in the pose in which lengths were measured."""
    names = ["flexion_deg", "varus_deg", "internal_deg", "x_mm", "y_mm", "z_mm"]
    sds = 3 * [sd_deg] + 3 * [sd_mm]
    made = stated_errors("reference_pose", names, sds)
    changed = partial(_with_reference_pose, tuple(np.flatnonzero(sds).tolist()))
    return InputsChange(name="reference_pose", parameters=made, changed=changed)


def _with_law(part: str, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    scaled = {part: getattr(setting.law, part) * float(np.exp(values[0]))}
    return replace(setting, law=replace(setting.law, **scaled))


def _with_toe_region(setting: MechanicsInputs, values: Array) -> MechanicsInputs:
    longer = np.where(setting.owner >= 0, float(np.exp(values[0])), 1.0)
    lines = replace(setting.lines, transition=longer * setting.lines.transition)
    return replace(setting, lines=lines)


def _with_reference_pose(
    used: tuple[int, ...], setting: MechanicsInputs, values: Array
) -> MechanicsInputs:
    """The inputs with the reference lengths of the subject's ligaments in the other pose."""
    whole = np.zeros(6)
    whole[list(used)] = values
    turn, shift = np.radians(whole[:3]), whole[3:]
    pose = setting.start + np.r_[turn[1:], shift]
    lengths = line_lengths(setting.lines, setting.start_flexion + turn[0], pose)
    change = np.where(setting.owner >= 0, lengths - setting.lengths_at_start(setting.lines), 0.0)
    lines = replace(setting.lines, reference_length=setting.lines.reference_length + change)
    return replace(setting, lines=lines)


NAMES = [f"{bone}_{axis}_{unit}" for bone in BONES for unit in ("deg", "mm") for axis in "xyz"]


@declared
class Registration:
    """The pose of each bone's measured frame in the frame of its geometry [deg, mm].

    A rigid transform of each bone: rotations about and shifts along the axes of the geometry's
    frame. The model moves between the measured frames: readings, axes and points of the loads and
    the flexion that the rig prescribes are theirs.
    """

    sd_deg: float = entry("Prior standard deviation of the rotations; 0 where there are none")
    sd_mm: float = entry("Prior standard deviation of the shifts; 0 where there are none")
    name: str = entry("Name of the cause", default="registration")
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", stated_errors(self.name, NAMES, self._sds))

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with poses measured between the frames at amplitudes `values`."""
        return replace(setting, frames=frames_at(self._whole(values[None])[0]))

    def placements(self, values: Array) -> tuple[Array, Array]:
        """Axes and origins of frames at k rows of amplitudes, ``(k, 2, 3, 3)``, ``(k, 2, 3)``."""
        return placements(self._whole(values))

    @property
    def _sds(self) -> list[float]:
        return 2 * (3 * [self.sd_deg] + 3 * [self.sd_mm])

    def _whole(self, values: Array) -> Array:
        whole = np.zeros((len(values), len(NAMES)))
        whole[:, np.flatnonzero(self._sds)] = values
        return whole


# For each error the fields of `Uncertainty` that state it, and the function that makes it of them.
_ERRORS = MappingProxyType[str, tuple[tuple[str, ...], Callable[..., Effect]]](
    {
        "reference_pose": (("reference_pose_deg", "reference_pose_mm"), reference_pose),
        "contact_modulus": (("contact_modulus",), contact_modulus),
        "contact_exponent": (("contact_exponent",), contact_exponent),
        "toe_region": (("toe_region",), toe_region),
        "load_gain": (("load_gain",), load_gain),
        "load_axes": (("load_axes_deg",), load_axes),
        "flexion": (("flexion_deg",), flexion),
        "state_elongation": (("state_elongation",), state_elongation),
        "state_drift": (("state_drift_mm", "state_drift_deg"), state_drift),
        "registration": (
            ("registration_deg", "registration_mm"),
            lambda sd_deg, sd_mm: Registration(sd_deg=sd_deg, sd_mm=sd_mm),
        ),
    }
)


def nuisances_of(knee: Knee) -> tuple[Effect, ...]:
    """The stated nuisance parameters of a knee, in the order in which they act; may be empty.

    Errors that are marginalised without parameters are not among them: see
    `identknee.model.residuals`.

    Examples
    --------
    >>> from identknee.subject.reference import reference_knee
    >>> from identknee.subject.knee import Uncertainty
    >>> knee = reference_knee().with_uncertainty(Uncertainty(load_gain=0.03))
    >>> [x.name for x in nuisances_of(knee)]
    ['load_gain']
    """
    stated = knee.uncertainty
    made: list[Effect] = []
    if not isinstance(stated.insertions_mm, float) or stated.insertions_mm > 0.0:
        made.append(insertions(knee))
    if stated.structures > 0.0:
        made += structures_lacking(knee, stated.structures)
    for parts, make in _ERRORS.values():
        sizes = [getattr(stated, x) for x in parts]
        if max(sizes) > 0.0:
            made.append(make(*sizes))
    return tuple(made)


def contact_rounding(knee: Knee) -> float:
    """Rounding of the contact law of a knee [mm]: the largest if geometry or tests are uncertain.

    With nuisances a search goes far along bent valleys. Without rounding the stiffness of the joint
    jumps wherever a contact point begins to touch, and derivatives do not show it. Rounding changes
    predictions by 0.02 mm and 0.04 deg rms at most (two knees, 63 trials). An exact knee keeps the
    law that it was fitted with, which is the paper's unless the knee states another.
    """
    return MOST_ROUNDING if nuisances_of(knee) else knee.contact_rounding_mm


class StoredWithKnee(tuple[Effect, ...]):
    """Default argument: the effects and nuisances stored with the knee."""

    __slots__ = ()


def stored_effects(knee: Knee) -> tuple[Effect, ...]:
    """The effects stored with a knee, then its nuisances.

    An effect that is stored and stated as a nuisance acts once, with the prior of the nuisance. A
    stored error that is not stated is fixed at its stored amplitudes.

    Raises
    ------
    ValueError
        If a stored error has no amplitude of a stored name.
    """
    stated = nuisances_of(knee)
    names = {x.name for x in stated}
    held = []
    for choice in knee.effects:
        if choice.name in names or choice.name not in _ERRORS:
            continue
        parts, make = _ERRORS[choice.name]
        # Any spread does, because all amplitudes are fixed.
        effect = make(*[1.0] * len(parts))
        sizes = dict.fromkeys(effect.parameters.names, 0.0)
        for name, value in choice.values.items():
            effect.parameters.index(f"{choice.name}.{name}")
            sizes[f"{choice.name}.{name}"] = value
        held.append(with_fixed_amplitudes(effect, sizes))
    errors = (*held, *stated)
    names = {x.name for x in errors}
    if any(x.name in names for x in knee.effects):
        knee = knee.with_effects([x for x in knee.effects if x.name not in names])
    return (*effects_of(knee), *errors)
