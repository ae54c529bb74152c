"""Structures that the model may lack: single lines and the posterior capsule, placed by anatomy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from identknee.mechanics.equilibria import LineLigaments
from identknee.mechanics.ligament_tensions import ligament_tensions, line_gradients
from identknee.model.effects.effect import amplitudes
from identknee.model.mechanics_inputs import PER_KN, PER_PCT, MechanicsInputs, with_lines
from identknee.model.parameters import STIFFNESS, STRAIN, Parameters
from identknee.runs.declare import Array, array, declared, entry
from identknee.subject.knee import AXES, BONES, Knee, Points
from identknee.subject.menisci import SIDES

SITE_SD = 4.0  # standard deviation of insertions around their anatomical sites [mm]
SITE_SDS = 3.0  # bound of a shift, in these standard deviations
SITE_STEP = 1e-4  # of central differences [mm]
SHIFTS = tuple(f"{bone}_{axis}_mm" for bone in BONES for axis in AXES)


@declared
class MissingStructure:
    """Lines of one stiffness and one reference strain, at sites that may be shifted."""

    name: str = entry("Name of the structure")
    femoral: Array = array("Insertions in femoral axes", "line", "axis", unit="mm")
    tibial: Array = array("Insertions in tibial axes", "line", "axis", unit="mm")
    stiffness_sd: float = entry("Standard deviation of the half-normal prior of the stiffness [kN]")
    sites_vary: bool = entry(
        "Whether both insertions may be shifted; all lines are shifted together", default=True
    )
    site_sd: float = entry("Prior standard deviation of each shift [mm]", default=SITE_SD)
    is_nuisance: bool = entry("Whether its amplitudes are nuisances", default=False)
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        names, sd = [STIFFNESS, STRAIN], [self.stiffness_sd, 4.0]
        lower, upper = [0.0, -10.0], [6.0 * self.stiffness_sd, 12.0]
        if self.sites_vary:
            names += SHIFTS
            sd += 6 * [self.site_sd]
            lower += 6 * [-SITE_SDS * self.site_sd]
            upper += 6 * [SITE_SDS * self.site_sd]
        center = [0.0, 1.5, *[0.0] * (len(names) - 2)]
        made = amplitudes(self.name, names, sd, lower=lower, upper=upper, center=center)
        made = made.as_nuisances() if self.is_nuisance else made
        object.__setattr__(self, "parameters", made)

    @property
    def first_shift(self) -> int:
        """Index of the first shift among the amplitudes, after the reference strain."""
        return 2

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with the structure added."""
        m = len(self.femoral)
        lines = _measured(setting, *self.insertions(values))
        stiffness, strain = np.full(m, PER_KN * values[0]), np.full(m, PER_PCT * values[1])
        return with_lines(setting, lines, stiffness, strain)

    def gradient_columns(
        self, setting: MechanicsInputs, values: Array, flexion: Array, poses: Array
    ) -> Array:
        """Derivatives of the energy's gradient by the amplitudes at fixed poses, ``(n, 5, a)``.

        Derivatives by the shifts are central differences, with all lines shifted together.
        """
        femoral, tibial = self.insertions(values)
        m, strain = len(femoral), PER_PCT * values[1]
        own = ligament_tensions(
            setting.as_measured(_measured(setting, femoral, tibial)),
            flexion,
            poses,
            np.full(m, PER_KN * values[0]),
            np.full(m, strain),
        )
        columns = np.zeros((len(flexion), 5, len(values)))
        columns[:, :, 0] = PER_KN * np.einsum("nm,nma->na", own.by_stiffness, own.lengthening)
        columns[:, :, 1] = PER_PCT * np.einsum("nm,nma->na", own.by_strain, own.lengthening)
        if not self.sites_vary:
            return columns
        moves = SITE_STEP * np.concatenate([np.eye(6), -np.eye(6)])
        shifted = _measured(
            setting,
            (femoral + moves[:, None, :3]).reshape(-1, 3),
            (tibial + moves[:, None, 3:]).reshape(-1, 3),
        )
        n_lines = len(moves) * m
        pulls = line_gradients(
            setting.as_measured(shifted),
            flexion,
            poses,
            np.full(n_lines, PER_KN * values[0]),
            np.full(n_lines, strain),
        )
        ends = pulls.reshape(len(flexion), 2, 6, m, 5).sum(axis=3)
        columns[:, :, 2:] = (ends[:, 0] - ends[:, 1]).transpose(0, 2, 1) / (2.0 * SITE_STEP)
        return columns

    def insertions(self, values: Array) -> tuple[Array, Array]:
        """Femoral and tibial insertions with the shifts of `values` [mm], each ``(m, 3)``."""
        shift = values[2:] if self.sites_vary else np.zeros(6)
        return self.femoral + shift[:3], self.tibial + shift[3:]


def _measured(setting: MechanicsInputs, femoral: Array, tibial: Array) -> LineLigaments:
    """Lines between insertions, with their length in the scanned pose as reference length."""
    lines = LineLigaments(femoral=femoral, tibial=tibial, reference_length=np.ones(len(femoral)))
    return replace(lines, reference_length=setting.lengths_at_start(lines))


def structure_at(
    knee: Knee,
    name: str,
    insertions: Sequence[tuple[Array, Array]],
    *,
    stiffness_sd: float,
    sites_vary: bool = True,
) -> MissingStructure:
    """A missing structure at femoral and tibial points in the common frame of the scan [mm]."""
    return MissingStructure(
        name=name,
        femoral=knee.femur_frame.to_local(np.array([x for x, _ in insertions])),
        tibial=knee.tibia_frame.to_local(np.array([x for _, x in insertions])),
        stiffness_sd=stiffness_sd,
        sites_vary=sites_vary,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosteriorCapsule:
    """The medial and the lateral capsule, with two stiffnesses and one reference strain.

    Attributes
    ----------
    medial, lateral
        Structures of one line each; `sites_vary` must be the same for both.
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
        made = made.as_nuisances() if self.medial.is_nuisance else made
        object.__setattr__(self, "parameters", made)

    @property
    def sites_vary(self) -> bool:
        """Whether the insertions of both lines may be shifted."""
        return self.medial.sites_vary

    @property
    def first_shift(self) -> int:
        """Index of the first shift among the amplitudes, after the reference strain."""
        return 3

    def change(self, setting: MechanicsInputs, values: Array) -> MechanicsInputs:
        """The inputs with both lines added."""
        medial, lateral = self._of_sides(values)
        return self.lateral.change(self.medial.change(setting, medial), lateral)

    def gradient_columns(
        self, setting: MechanicsInputs, values: Array, flexion: Array, poses: Array
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
        medial, lateral = np.split(values[self.first_shift :], 2)
        return np.r_[values[0], values[2], medial], np.r_[values[1], values[2], lateral]


CAPSULE = "posterior_capsule"
# Prior standard deviation of the stiffness of structures [kN]; of any other name, the last.
STIFFNESS_SD: Mapping[str, float] = MappingProxyType(
    {
        "anterolateral": 1.2,
        "posteromedial": 1.5,
        "popliteofibular": 1.2,
        "deep_mcl": 1.2,
        CAPSULE: 1.0,
    }
)
OTHER_STIFFNESS_SD = 1.5
# mm; the lines of the capsule stand for sheets as wide as a condyle.
CAPSULE_SITE_SD = 6.0
Structure = MissingStructure | PosteriorCapsule


def structure(
    knee: Knee,
    name: str,
    lines: Sequence[Points],
    *,
    stiffness_sd: float | None = None,
    site_sd: float | None = None,
    is_nuisance: bool = False,
) -> Structure:
    """A missing structure between points of the common frame of the scan.

    The posterior capsule has a medial and then a lateral line, each with its own stiffness and
    shifts; the lines of any other structure share them.

    Parameters
    ----------
    knee
        The subject.
    name
        Name of the structure.
    lines
        Femoral and tibial point [mm] of each line, shape ``(3,)``.
    stiffness_sd
        Scale of the half-normal prior of the stiffness [kN]; the named structure's where None.
    site_sd
        Prior standard deviation of the shifts of both ends [mm], 0 where they are not shifted; the
        usual one where None.
    is_nuisance
        Whether its amplitudes are nuisances.

    Raises
    ------
    ValueError
        If a posterior capsule has not two lines.
    """
    sd = stiffness_sd or STIFFNESS_SD.get(name, OTHER_STIFFNESS_SD)
    usual = CAPSULE_SITE_SD if name == CAPSULE else SITE_SD
    spread = usual if site_sd is None else site_sd

    def made(lines: Sequence[Points]) -> MissingStructure:
        at = structure_at(knee, name, lines, stiffness_sd=sd, sites_vary=spread > 0.0)
        return replace(at, site_sd=spread, is_nuisance=is_nuisance)

    if name != CAPSULE:
        return made(lines)
    if len(lines) != 2:
        raise ValueError(f"{CAPSULE} has a medial and a lateral line, got {len(lines)} lines")
    medial, lateral = (made([line]) for line in lines)
    return PosteriorCapsule(medial=medial, lateral=lateral)


def lines_of(knee: Knee, made: Structure) -> tuple[Points, ...]:
    """The points between which the lines of a structure run, in the common frame [mm]."""
    parts = (made.medial, made.lateral) if isinstance(made, PosteriorCapsule) else (made,)
    return tuple(
        (knee.femur_frame.to_common(femur), knee.tibia_frame.to_common(tibia))
        for part in parts
        for femur, tibia in zip(part.femoral, part.tibial, strict=True)
    )
