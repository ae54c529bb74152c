"""The laxity model: a knee under a protocol, its geometry, parameters, prediction and Jacobian."""

import hashlib
import io
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import ceil
from typing import Any, Literal
from zipfile import BadZipFile

import numpy as np

from identknee.laxity.experiments import INTACT
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import Laxity
from identknee.mechanics.contact_points import (
    DEFAULT_NUMBER,
    ContactPlaces,
    RimDistance,
    contact_places,
    contact_points,
    gaps_to,
    meniscus_places,
    rim_distance,
)
from identknee.mechanics.distance_field import (
    PADDING,
    SPACING,
    ContactLaw,
    DistanceField,
    build_field,
)
from identknee.mechanics.equilibria import (
    NO_MENISCI,
    ContactPoints,
    Continuation,
    LineLigaments,
    LoadPaths,
    Menisci,
    load_paths,
    paths_of_release,
)
from identknee.mechanics.ligament_tensions import line_lengths, wrapped_lines
from identknee.mechanics.memory import CONVERGED, NO_EQUILIBRIUM, Equilibria
from identknee.mechanics.mesh_contact import mesh_contact, mesh_equilibria
from identknee.mechanics.pose import coordinate_jacobian, coordinates_from_pose, place, start_pose
from identknee.model.effects.effect import Effect, EffectStack, TrialRecord, scope_of
from identknee.model.experiments import effects_in_experiments, effects_of_part, kinds_of_trials
from identknee.model.mechanics_inputs import (
    PER_KN,
    PER_PCT,
    MechanicsInputs,
    fallback_poses,
    known_poses,
    measured_poses,
    poses_between,
    poses_of_measured_trials,
)
from identknee.model.nuisances import StoredWithKnee, contact_rounding
from identknee.model.parameter_groups import (
    ParameterGroups,
    knee_parameters,
    lines_by_units,
    tied,
)
from identknee.model.parameters import Parameters
from identknee.model.prediction import Prediction, solve_beyond_folds
from identknee.runs.declare import Array, IntArray, array, declared, entry, frozen, short_repr
from identknee.runs.errors import InputError
from identknee.runs.files import cache_folder, prepare_folder, write_atomically
from identknee.runs.progress import stage
from identknee.runs.record import Outcome
from identknee.subject.femoral_distance import distance_to_femur
from identknee.subject.knee import Frame, Knee
from identknee.subject.menisci import (
    FIELD_REACH,
    HIGHEST,
    SIDES,
    on_periphery,
    width_of_menisci,
)
from identknee.subject.surface import Surface

FIELD_FORMAT = b"field 6"
Sheet = tuple[Array, IntArray]


@declared
class ContactGeometry:
    """Geometry of a knee as arrays for the compiled mechanics."""

    field: DistanceField = entry("Signed distance to the femur, in femoral axes")
    contact: ContactPoints = entry("Points of the tibia that carry contact, in tibial axes")
    lines: LineLigaments = entry("The ligaments")
    femoral_rim: RimDistance = entry("How far places on the femoral surface are from its rim")
    tibial_rims: tuple[RimDistance, ...] = entry("Distance from the rim of each tibial surface")
    start_flexion: float = entry("Flexion of the scanned pose [rad]")
    start: Array = entry("The scanned pose: varus, internal [rad], x, y, z [mm], shape ``(5,)``")


@lru_cache(maxsize=16)
def contact_geometry(knee: Knee, n_points: int | None = DEFAULT_NUMBER) -> ContactGeometry:
    """The joint of a knee with about `n_points` contact points (None for every vertex).

    The distance field is read from the cache on disk where it was built before.
    """
    flexion, start = start_pose(
        knee.femur_frame.axes @ knee.tibia_frame.axes.T,
        knee.femur_frame.to_local(knee.tibia_frame.origin[None])[0],
    )
    contact, tibial_rims = _tibial_contact(knee.tibia, knee.tibia_frame, n_points)
    rounding = contact_rounding(knee)
    if rounding:
        contact = replace(contact, law=ContactLaw(rounding=rounding))
    lines = lines_in_bones(knee)
    if wrapped_lines(lines).size:
        # The mechanics smooth the contact of a line with its obstacle, so their length is used.
        lines = replace(lines, reference_length=line_lengths(lines, flexion, start))
    return ContactGeometry(
        field=_field(knee),
        contact=contact,
        lines=lines,
        femoral_rim=_femoral_rim(knee.femur, knee.femur_frame),
        tibial_rims=tibial_rims,
        start_flexion=flexion,
        start=frozen(start, 5, name="start"),
    )


def lines_in_bones(knee: Knee) -> LineLigaments:
    """The ligaments' lines in the frames of their bones."""
    own = knee.ligaments
    n, frames = len(own), {"femur": knee.femur_frame, "tibia": knee.tibia_frame}
    radius, is_tibial, centre, axis = np.zeros(n), np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3))
    for i, x in enumerate(own):
        if x.wrap is not None:
            frame = frames[x.wrap.bone]
            radius[i], is_tibial[i] = x.wrap.radius_mm, float(x.wrap.bone == "tibia")
            centre[i] = frame.to_local(x.wrap.centre[None])[0]
            axis[i] = frame.axes @ x.wrap.turning_axis(x.femur, x.tibia)
    return LineLigaments(
        femoral=knee.femur_frame.to_local(np.array([x.femur for x in own]).reshape(-1, 3)),
        tibial=knee.tibia_frame.to_local(np.array([x.tibia for x in own]).reshape(-1, 3)),
        reference_length=knee.reference_lengths,
        obstacle_radius=radius,
        obstacle_is_tibial=is_tibial,
        obstacle_centre=centre,
        obstacle_axis=axis,
    )


# Cached apart from the knee: subjects with the same surfaces differ in priors and insertions.
@lru_cache(maxsize=4)
def _tibial_contact(
    surfaces: tuple[Surface, ...], frame: Frame, n_points: int | None
) -> tuple[ContactPoints, tuple[RimDistance, ...]]:
    """The points that carry contact, and how far places are from each surface's rim."""
    sheets = [(frame.to_local(x.vertices), x.faces) for x in surfaces]
    return contact_points(sheets, n_points), tuple(rim_distance(*x) for x in sheets)


def contact_sheets(knee: Knee) -> tuple[Sheet, tuple[Sheet, ...]]:
    """Vertices and faces of the femur in femoral axes, of each tibial surface in tibial axes."""
    femur = (knee.femur_frame.to_local(knee.femur.vertices), knee.femur.faces)
    tibia = tuple((knee.tibia_frame.to_local(x.vertices), x.faces) for x in knee.tibia)
    return femur, tibia


# Grid of the distance field for menisci: coarser, since only gaps are looked up in it.
WIDE_SPACING, WIDE_PADDING = 2.0 * SPACING, ceil(FIELD_REACH / (2.0 * SPACING)) + 3
# Points of both menisci together: fewer than for contact suffice, because menisci are soft.
MENISCUS_POINTS = 200
DECIMALS = 6  # of coordinates in mm


@lru_cache(maxsize=4)
def meniscus_geometry(knee: Knee, number: int | None = MENISCUS_POINTS) -> Menisci:
    """The menisci of a knee as wedges that fill the gaps in the scanned pose, without stiffness.

    Parameters
    ----------
    knee
        The subject.
    number
        About how many points there are; None for every vertex below the menisci. None lie on a
        plateau that has no rim, or no gap near it.
    """
    joint = contact_geometry(knee)
    field = _field(knee, spacing=WIDE_SPACING, padding=WIDE_PADDING)
    scanned = place(joint.start_flexion, joint.start)
    below, sides = [], []
    sheets = zip(contact_sheets(knee)[1], joint.tibial_rims, (1.0, -1.0), strict=True)
    for side, ((vertices, faces), rim, inward) in enumerate(sheets):
        # Rounding errors of another position in the scanner must not change the patches.
        vertices = np.round(vertices, DECIMALS)
        centroids = vertices[faces].mean(axis=1)
        gaps = gaps_to(field, scanned.to_femur(centroids))
        own = on_periphery(centroids, rim, inward, width_of_menisci(knee))
        own &= (gaps > 0.0) & (gaps <= HIGHEST)
        if own.any():
            used, renamed = np.unique(faces[own], return_inverse=True)
            below.append((vertices[used], renamed.reshape(-1, 3)))
            sides.append(side)
    if not below:
        return NO_MENISCI
    found = contact_points(below, number)
    heights = gaps_to(field, scanned.to_femur(found.points))
    return Menisci(
        points=found.points,
        areas=found.areas,
        heights=heights,
        side=np.array(sides)[found.compartment],
        stiffness=np.zeros(len(SIDES)),
        field=field,
    )


@lru_cache(maxsize=4)
def _femoral_rim(femur: Surface, frame: Frame) -> RimDistance:
    """How far places on the femur are from its rim."""
    return rim_distance(frame.to_local(femur.vertices), femur.faces)


def _field(knee: Knee, *, spacing: float = SPACING, padding: int = PADDING) -> DistanceField:
    """The distance field of the femur, from the cache or built and put there."""
    if knee.femur_distance is None:
        return _field_of_mesh(knee.femur, knee.femur_frame, spacing, padding)
    return _field_of(knee.femur, knee.femur_frame, knee.femur_distance, spacing, padding)


# Cached apart from the knee, as above.
@lru_cache(maxsize=4)
def _field_of_mesh(femur: Surface, frame: Frame, spacing: float, padding: int) -> DistanceField:
    return _field_of(femur, frame, None, spacing, padding)


def _field_of(
    femur: Surface,
    frame: Frame,
    closed_form: Callable[[Array], Array] | None,
    spacing: float,
    padding: int,
) -> DistanceField:
    femoral = frame.to_local(femur.vertices)
    distance: Callable[[Array], Array] | None = None
    digest = hashlib.sha256(FIELD_FORMAT + repr(spacing).encode())
    if padding != PADDING:
        digest.update(repr(padding).encode())
    digest.update(femoral.tobytes())
    if closed_form is not None:

        def distance(points: Array) -> Array:
            return closed_form(frame.to_common(points))

        # A function cannot be hashed, so its values at some points near the surface are.
        digest.update(distance(femoral[::7] * 1.02).tobytes())
    else:
        digest.update(femur.faces.tobytes())
    path = cache_folder() / "fields" / f"{digest.hexdigest()[:24]}.npz"
    arrays = ("coefficients", "reach", "near", "origin", "spacing")
    # The file does not exist, or is damaged.
    missing = suppress(OSError, KeyError, ValueError, EOFError, BadZipFile)
    with missing, path.open("rb") as file, np.load(file) as kept:
        values = {x: kept[x] for x in arrays}
        return DistanceField(**{**values, "spacing": float(values["spacing"])})
    if distance is None:
        with stage("sorting the femoral surface"):
            distance = distance_to_femur(femur, frame)
    lower, upper = femoral.min(axis=0), femoral.max(axis=0)
    field = build_field(distance, lower, upper, spacing=spacing, padding=padding)
    stored = io.BytesIO()
    np.savez(stored, **{x: getattr(field, x) for x in arrays})
    # A cache that cannot be written is no failure.
    with suppress(InputError):
        write_atomically(prepare_folder(path.parent) / path.name, stored.getvalue())
    return field


Contact = Literal["field", "mesh"]
# From the loads of a protocol (internal and varus moment [N·m], anterior, distraction and lateral
# force [N]) to generalised loads of (varus, internal [N mm], x, y, z [N]).
_GENERALISED = np.array(
    [
        [0.0, 1000.0, 0.0, 0.0, 0.0],
        [1000.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, -1.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0],
    ]
)


class _LastPrediction(threading.local):
    """Cache of the last prediction of each thread."""

    made: "tuple[tuple[LaxityModel, Prediction], ...]" = ()


_LAST = _LastPrediction()
# Number of models whose last prediction a thread remembers: with `HeldTrials` residuals alternate
# between two models.
REMEMBERED = 2


# Fields of a prediction with a row for each trial, and those with a column for each parameter too.
OF_TRIALS = (
    "coordinates",
    "held_coordinates",
    "codes",
    "poses",
    "reached",
    "released",
    "centres",
    "menisci",
    "hessians",
)
JACOBIANS = ("jacobian", "held_jacobian", "pose_jacobian")


@declared
class Part:
    """The trials of a model that are of one rig, mounting and state of the knee."""

    model: "LaxityModel" = entry("The model of these trials")
    trials: IntArray = array("Their places among all", "trial", dtype=int)
    columns: IntArray = array("Places of its parameters among all", "parameter", dtype=int)

    def prediction(self, whole: "Prediction") -> "Prediction":
        """The prediction of this part, from that of the whole model."""
        values: dict[str, Any] = {}
        for name in (*OF_TRIALS, *JACOBIANS):
            value = getattr(whole, name)
            values[name] = None if value is None else value[self.trials]
            if value is not None and name in JACOBIANS:
                values[name] = values[name][:, :, self.columns]
        return replace(whole, theta=whole.theta[self.columns], **values)

    def places(self, trials: Sequence[int] | IntArray) -> tuple[IntArray, IntArray]:
        """Which of some trials of the whole model are in this part, and their indices in it."""
        asked = np.asarray(trials, np.int64)
        rows = np.flatnonzero(np.isin(asked, self.trials))
        return rows, np.searchsorted(self.trials, asked[rows])

    def spread(self, values: Array, into: Array, rows: IntArray | None = None) -> None:
        """Write derivatives by the parameters of this part into those by all parameters.

        Parameters
        ----------
        values
            Derivatives in k trials of this part by its parameters, shape ``(k, ..., p)``.
        into
            Derivatives in all trials by all parameters, which are changed, ``(n, ..., q)``.
        rows
            Rows of `into` that are written; those of the trials of this part if None.
        """
        place = np.zeros((*values.shape[:-1], into.shape[-1]))
        # A trial without equilibrium is NaN in all columns, not only in those of this part.
        place[np.isnan(values).all(axis=-1)] = np.nan
        place[..., self.columns] = values
        into[self.trials if rows is None else rows] = place


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaxityModel:
    """A knee under a protocol.

    Attributes
    ----------
    knee
        The subject.
    protocol
        The trials to predict.
    continuation
        How a trial's equilibrium is found: ``"continuation"`` follows the branch that starts
        unloaded in the scanned pose, the canonical answer; ``"single-step"`` puts the whole load on
        the scanned pose at once, as the paper did.
    n_points
        About how many contact points to use; None for every vertex of the tibial surfaces.
    effects
        Physical effects that extend the knee, in the order in which they act. By default those
        stored with the knee, and its nuisances. Their amplitudes are parameters after those of the
        ligaments, with the values stored with the knee as the subject's own.
    order, phase
        As in `Laxity`, for effects that depend on when a trial was run.
    poses
        Measured pose of each trial: varus, internal [rad], x, y, z [mm], shape ``(n, 5)``. The full
        load then acts from the beginning, and the equilibrium is followed from this pose while a
        spring that holds the knee there lets go. By default the poses that are stated for the knee.
        None where there are none: paths then begin in the scanned pose, without load.
    fallback_poses
        Pose of each trial from which the equilibrium under full load is searched for if its path
        ends before, shape ``(n, 5)``, NaN where unknown. These are the measured poses, if the knee
        states errors. With None such a trial has no equilibrium.
    contact
        ``"field"`` integrates pressure over the tibia (smooth, does not depend on the meshes);
        ``"mesh"`` is the paper's law with the vertices of both surfaces, for comparison: slow, and
        without derivatives, since its force jumps.
    """

    knee: Knee
    protocol: Protocol
    continuation: Continuation = "continuation"
    n_points: int | None = DEFAULT_NUMBER
    contact: Contact = "field"
    effects: tuple[Effect, ...] = StoredWithKnee()
    order: IntArray | None = None
    phase: tuple[str, ...] | None = None
    poses: Array | None = None
    fallback_poses: Array | None = None
    joint: ContactGeometry = field(init=False, repr=False)
    paths: LoadPaths = field(init=False, repr=False)
    parameters: Parameters = field(init=False, repr=False)
    tied: ParameterGroups = field(init=False, repr=False)
    extension: EffectStack = field(init=False, repr=False)
    parts: tuple[Part, ...] = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        joint = contact_geometry(self.knee, self.n_points)
        flexion = np.radians(self.protocol.flexion_deg)
        loads = self.protocol.loads @ _GENERALISED
        if self.poses is None and self.continuation == "continuation":
            object.__setattr__(self, "poses", known_poses(self.knee, self.protocol))
        if self.poses is None:
            paths = load_paths(flexion, loads, joint.start_flexion, self.continuation)
        else:
            paths = paths_of_release(flexion, loads)
        is_stored = isinstance(self.effects, StoredWithKnee)
        own = effects_in_experiments(self.knee, self.protocol) if is_stored else self.effects
        effects = tuple(own)
        object.__setattr__(self, "effects", effects)
        extension = EffectStack(effects=effects)
        if effects and self.contact == "mesh":
            raise ValueError('effects need contact="field": mesh contact has no derivatives')
        around = [x.name for x in self.knee.ligaments if x.wrap is not None]
        if around and self.contact == "mesh":
            raise ValueError(
                f"mesh contact takes straight ligaments, and {', '.join(around)} wrap around an "
                'obstacle; use contact="field"'
            )
        units = tied(self.knee)
        parameters = knee_parameters(self.knee, units, extension.parameters)
        derived = {"tied": units, "joint": joint, "paths": paths, "extension": extension}
        for name, value in {**derived, "parameters": parameters}.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "parts", parts_of(self))

    @property
    def n_ligament_parameters(self) -> int:
        """Number of ligament parameters, which precede those of the effects."""
        return 2 * self.tied.n

    def with_protocol(self, protocol: Protocol) -> "LaxityModel":
        """A copy under another protocol with unknown trial order; self if unchanged."""
        if protocol is self.protocol:
            return self
        made = self.protocol
        if made.experiments and not protocol.experiments:
            # A protocol without experiments belongs to the first experiment of the model.
            protocol = replace(protocol, experiments=made.experiments)
        return replace(
            self,
            protocol=protocol,
            order=None,
            phase=None,
            poses=poses_between(made, self.poses, protocol),
            fallback_poses=poses_of_measured_trials(made, self.fallback_poses, protocol),
        )

    def with_tests(self, laxity: Laxity) -> "LaxityModel":
        """A copy under the protocol of measured laxity, with its trial order and phase."""
        model = self.with_protocol(laxity.protocol)
        poses = fallback = None
        if self.continuation == "continuation":
            poses = measured_poses(laxity)
            poses = known_poses(self.knee, laxity.protocol) if poses is None else poses
            fallback = fallback_poses(self.knee, laxity) if poses is None else None
        is_known = model.order is laxity.order and model.phase is laxity.phase
        is_same = all(
            x is y if x is None or y is None else np.array_equal(x, y, equal_nan=True)
            for x, y in ((model.poses, poses), (model.fallback_poses, fallback))
        )
        if (is_known or not self.effects) and is_same:
            return model
        return replace(
            model, order=laxity.order, phase=laxity.phase, poses=poses, fallback_poses=fallback
        )

    def with_effects(self, effects: Sequence[Effect]) -> "LaxityModel":
        """A copy with these effects in place of its own."""
        return replace(self, effects=tuple(effects))

    def predict(
        self, theta: Array, *, derivatives: bool = True, near: Prediction | None = None
    ) -> Prediction:
        """Pose of the tibia in every trial, and how it changes with theta.

        Parameters
        ----------
        theta
            Parameter vector in the order and units of `parameters`, shape ``(p,)``.
        derivatives
            Whether the Jacobian is wanted.
        near
            A prediction at a parameter vector close by, to start from. It saves time and does not
            change the result: equilibria found from it pass the same tests.

        Raises
        ------
        ValueError
            If theta has the wrong length or holds a stiffness below 0 or a reference strain of
            -100 % or less. A trial without equilibrium is not an error: it has an outcome.
        """
        if self.parts:
            near_by_part = guesses(self.parts, near)
            self._unpacked(theta)
            found_by_part = [
                part.model.predict(np.asarray(theta)[part.columns], derivatives=derivatives, near=x)
                for part, x in zip(self.parts, near_by_part, strict=True)
            ]
            return merged_prediction(self.parts, found_by_part, theta)
        if self.contact == "mesh":
            if derivatives:
                raise ValueError(
                    "mesh contact has no derivatives, its force jumps; ask for derivatives=False, "
                    'or use contact="field"'
                )
            ligaments = self._unpacked(theta)
            return predict_on_meshes(self.knee, self.paths, self.poses, ligaments, theta)
        unchanged = self.setting(theta, is_changed=False)
        settings = self.extension.changes(unchanged, self.amplitudes(theta))
        setting = settings[-1]
        lines = setting.measured_lines.arrays(setting.stiffness, setting.reference_strain)
        paths = self.paths
        if setting.flexion is not paths.flexion or setting.loads is not paths.loads:
            paths = replace(paths, flexion=setting.flexion, loads=setting.loads)
        found = solve_beyond_folds(
            paths,
            setting.start_pose_of_search,
            (*self.surfaces(setting), lines),
            self.fallback_poses,
            derivatives=derivatives,
            guesses=None if near is None else near.node_poses,
        )
        return self._prediction(np.array(theta, float), settings, found, derivatives=derivatives)

    def setting(self, theta: Array, *, is_changed: bool = True) -> MechanicsInputs:
        """Mechanics inputs at theta, with the effects if `is_changed`.

        Raises
        ------
        ValueError
            As `predict`.
        """
        stiffness, strain = self._unpacked(theta)
        m = len(stiffness)
        setting = MechanicsInputs(
            flexion=self.paths.flexion,
            loads=self.paths.loads,
            lines=self.joint.lines,
            stiffness=stiffness,
            reference_strain=strain,
            owner=np.arange(m),
            share=np.ones(m),
            copy=np.zeros(m, int),
            law=self.joint.contact.law or ContactLaw(),
            start_flexion=self.joint.start_flexion,
            start=self.joint.start,
            measured=self.poses,
        )
        return self.extension.change(setting, self.amplitudes(theta)) if is_changed else setting

    def surfaces(self, setting: MechanicsInputs) -> tuple[ContactPoints, DistanceField]:
        """The surfaces of tibia and femur, for poses between the measured frames of the inputs."""
        contact, field = self.joint.contact, self.joint.field
        if self.effects:
            menisci = None
            if setting.menisci is not None:
                menisci = meniscus_geometry(self.knee).at(setting.menisci)
            contact = replace(contact, law=setting.law, menisci=menisci)
        frames = setting.frames
        return (
            (contact, field) if frames is None else (frames.contact(contact), frames.field(field))
        )

    @property
    def tests(self) -> TrialRecord:
        """The trials as they were made, with order and phase."""
        flexion_deg, loads = self.protocol.flexion_deg, self.protocol.loads
        return TrialRecord(flexion_deg=flexion_deg, loads=loads, order=self.order, phase=self.phase)

    def predict_once(self, theta: Array) -> Prediction:
        """The prediction at theta with its Jacobian, cached for the last theta.

        Residuals, their Jacobian and the quantities of one model thus share one simulation. Each
        thread remembers those of its last two models. It raises as `predict` does; mesh contact has
        no derivatives.
        """
        for model, made in _LAST.made:
            if model is self and np.array_equal(made.theta, theta):
                return made
        found = self.predict(theta)
        others = [x for x in _LAST.made if x[0] is not self]
        _LAST.made = ((self, found), *others[: REMEMBERED - 1])
        return found

    def simulate(self, theta: Array) -> Laxity:
        """The laxity table of the prediction at theta; trials that did not converge are blank."""
        prediction = self.predict(theta, derivatives=False)
        return Laxity(protocol=self.protocol, coordinates=prediction.coordinates)

    def _unpacked(self, theta: Array) -> tuple[Array, Array]:
        theta = np.asarray(theta, float)
        if theta.shape != (self.parameters.n,):
            raise ValueError(
                f"theta must have {self.parameters.n} values, one for each of "
                f"{', '.join(self.parameters.names)}; got shape {theta.shape}"
            )
        u = self.tied.n
        if not (np.isfinite(theta).all() and (theta[:u] >= 0.0).all()):
            raise self._implausible_parameter(theta)
        strain = self.tied.strain(theta[u : 2 * u]) * PER_PCT
        if not (strain > -1.0).all():
            raise self._implausible_parameter(theta)
        return self.tied.stiffness(theta[:u]) * PER_KN, strain

    def _implausible_parameter(self, theta: Array) -> ValueError:
        u = self.tied.n
        is_finite = np.isfinite(theta)
        strain = self.tied.strain(np.where(is_finite, theta, 0.0)[u : 2 * u]) * PER_PCT
        allowed = is_finite.copy()
        allowed[:u] &= theta[:u] >= 0.0
        allowed[u : 2 * u] &= ~(self.tied.member.T @ (strain <= -1.0)).astype(bool)
        worst = int(np.flatnonzero(~allowed)[0])
        return ValueError(
            f"{self.parameters.names[worst]} is {theta[worst]:g}: stiffness must be finite and "
            "at least 0 kN, reference strain finite and above -100 %"
        )

    def _prediction(
        self,
        theta: Array,
        settings: Sequence[MechanicsInputs],
        found: Equilibria,
        *,
        derivatives: bool,
    ) -> Prediction:
        nodes, setting = self.paths.trial_node, settings[-1]
        codes = np.array(found.codes[nodes])
        centres, menisci = found.centres[nodes], found.menisci[nodes]
        if setting.frames is not None:
            centres = setting.frames.centres(centres)
            menisci = setting.frames.centres(menisci)
        poses, reached = found.poses[nodes], found.reached[nodes]
        converged = codes == CONVERGED
        actual = coordinates_from_pose(poses)
        amplitudes = self.amplitudes(theta)
        measured = self.extension.observe(actual, amplitudes, self.tests)
        coordinates = np.where(converged[:, None], measured, np.nan)
        pose_jacobian = jacobian = held_jacobian = None
        if derivatives:
            is_at_rest = (found.codes == CONVERGED) | (
                self.paths.is_released & (found.reached > 0.0)
            )
            # Derivatives by lines come first: a parameter moves every line of its ligament.
            pose_jacobian = found.sensitivities[nodes][:, :, : 2 * setting.stiffness.size]
            if self.effects:
                owned = setting.owned(len(self.knee.ligaments))
                by_amplitude = self.extension.pose_columns(
                    settings, amplitudes, found, nodes, is_at_rest
                )
                by_ligament = pose_jacobian @ lines_by_units(owned, setting.share, self.tied)
                pose_jacobian = np.concatenate([by_ligament, by_amplitude], axis=2)
                seen, read = self.extension.observed_slopes(actual, amplitudes, self.tests)
                held_jacobian = seen @ (coordinate_jacobian(poses) @ pose_jacobian)
                held_jacobian[:, :, self.n_ligament_parameters :] += read
            else:
                m = len(self.tied.member)
                pose_jacobian = np.asarray(
                    pose_jacobian @ lines_by_units(np.eye(m), np.ones(m), self.tied)
                )
                held_jacobian = np.asarray(coordinate_jacobian(poses) @ pose_jacobian)
            jacobian = np.where(converged[:, None, None], held_jacobian, np.nan)
        return Prediction(
            theta=theta,
            coordinates=coordinates,
            jacobian=jacobian,
            held_coordinates=measured,
            held_jacobian=held_jacobian,
            pose_jacobian=pose_jacobian,
            codes=codes,
            poses=poses,
            hessians=found.hessians[nodes],
            reached=np.where(converged, 1.0, np.nan) if self.paths.is_released else reached,
            released=reached if self.paths.is_released else np.zeros(reached.shape),
            centres=centres,
            menisci=menisci,
            rims=(self.joint.femoral_rim, self.joint.tibial_rims),
            node_poses=found.poses,
        )

    def amplitudes(self, theta: Array) -> Array:
        """The amplitudes of the effects in theta."""
        return np.asarray(theta, float)[self.n_ligament_parameters :]


def parts_of(model: "LaxityModel") -> tuple[Part, ...]:
    """The parts of a model, by rig, mounting and state; empty where all trials share them.

    Raises
    ------
    ValueError
        If a state names no ligament of the knee, or cuts all of them.
    """
    protocol, parts = model.protocol, []
    kinds = kinds_of_trials(protocol)
    is_scoped = any(map(scope_of, model.effects))
    if len(set(kinds)) == 1 and kinds[0][1] == INTACT and not is_scoped:
        return ()
    places = {name: i for i, name in enumerate(model.parameters.names)}
    ligaments = model.parameters.names[: model.n_ligament_parameters]
    for experiment, state in dict.fromkeys(kinds):
        trials = np.array([i for i, x in enumerate(kinds) if x == (experiment, state)])
        own, effects = effects_of_part(model.knee, model.effects, experiment, state)
        plain = replace(protocol.select(trials), state=None, experiment=None, experiments=())
        part = replace(
            model,
            protocol=plain,
            effects=effects,
            order=None if model.order is None else model.order[trials],
            phase=None if model.phase is None else tuple(model.phase[i] for i in trials),
            poses=None if model.poses is None else model.poses[trials],
            fallback_poses=None if model.fallback_poses is None else model.fallback_poses[trials],
        )
        names = (*ligaments, *(name for x in own for name in x.parameters.names))
        columns = np.array([places[name] for name in names], dtype=np.int64)
        parts.append(Part(model=part, trials=trials, columns=columns))
    return tuple(parts)


def merged_prediction(
    parts: Sequence[Part], found: Sequence["Prediction"], theta: Array
) -> "Prediction":
    """The prediction of all trials from those of the parts."""
    n, first = sum(len(x.trials) for x in parts), found[0]
    values: dict[str, Any] = {}
    for name in OF_TRIALS:
        if getattr(first, name) is None:
            values[name] = None
            continue
        own = [np.asarray(getattr(x, name)) for x in found]
        whole = np.empty((n, *own[0].shape[1:]), own[0].dtype)
        for part, x in zip(parts, own, strict=True):
            whole[part.trials] = x
        values[name] = whole
    for name in JACOBIANS:
        values[name] = None
        if getattr(first, name) is not None:
            values[name] = np.zeros((n, 5, theta.size))
            for part, one in zip(parts, found, strict=True):
                part.spread(getattr(one, name), values[name])
    poses = np.concatenate([x.node_poses for x in found])
    return replace(first, theta=np.array(theta, float), node_poses=poses, **values)


def guesses(parts: Sequence[Part], near: "Prediction | None") -> list["Prediction | None"]:
    """The prediction that each part starts from, taken from one of the whole model."""
    if near is None:
        return [None] * len(parts)
    ends = np.cumsum([len(x.model.paths.flexion) for x in parts])[:-1]
    nodes = np.split(near.node_poses, ends)
    return [
        replace(part.prediction(near), node_poses=poses)
        for part, poses in zip(parts, nodes, strict=True)
    ]


def predict_on_meshes(
    knee: Knee, paths: LoadPaths, poses: Array | None, ligaments: tuple[Array, Array], theta: Array
) -> Prediction:
    """The prediction of a model with ``contact="mesh"``, which has no derivatives.

    Parameters
    ----------
    knee, paths, poses
        Those of the model.
    ligaments
        Stiffness [N] and reference strain of each ligament, shape ``(m,)``.
    theta
        The parameters that they come from.
    """
    joint = contact_geometry(knee)
    start = joint.start if poses is None else poses
    found = mesh_equilibria(
        paths, start, mesh_contact(*contact_sheets(knee)), joint.lines, *ligaments
    )
    n = len(paths.trial_node)
    converged = np.array([x is Outcome.CONVERGED for x in found.outcomes])
    return Prediction(
        theta=np.array(theta, float),
        coordinates=np.where(converged[:, None], coordinates_from_pose(found.poses), np.nan),
        jacobian=None,
        held_coordinates=coordinates_from_pose(found.poses),
        held_jacobian=None,
        pose_jacobian=None,
        codes=np.where(converged, CONVERGED, NO_EQUILIBRIUM),
        poses=found.poses,
        hessians=None,
        reached=np.ones(n),
        released=np.zeros(n),
        centres=np.zeros((n, 0, 7)),
        menisci=np.zeros((n, len(SIDES), 7)),
        rims=None,
        node_poses=found.poses,
    )


def trial_contacts(model: LaxityModel, prediction: Prediction) -> list[ContactPlaces]:
    """The contact of every trial in its predicted pose."""
    if model.parts:
        found = {
            int(trial): contact
            for x in model.parts
            for trial, contact in zip(
                x.trials, trial_contacts(x.model, x.prediction(prediction)), strict=True
            )
        }
        return [found[i] for i in range(len(prediction.codes))]
    whole = contact_of_trials(model, prediction)
    return [whole.of_pose(i) for i in range(len(prediction.codes))]


def contact_of_trials(model: LaxityModel, prediction: Prediction) -> ContactPlaces:
    """The contact of all trials of a model of one part, in their predicted poses."""
    setting = model.setting(prediction.theta)
    flexion = setting.flexion[model.paths.trial_node]
    return contact_places(*model.surfaces(setting), flexion, prediction.poses)


def menisci_of_trials(model: LaxityModel, prediction: Prediction) -> ContactPlaces:
    """The load on the menisci in all trials of a model of one part, in their predicted poses."""
    setting = model.setting(prediction.theta)
    flexion = setting.flexion[model.paths.trial_node]
    return meniscus_places(*model.surfaces(setting), flexion, prediction.poses)


def observed_slopes(model: LaxityModel, prediction: Prediction) -> Array:
    """Derivatives of the measured coordinates by the true ones, shape ``(n, 5, 5)``."""
    if model.parts:
        whole = np.zeros((len(prediction.codes), 5, 5))
        for x in model.parts:
            whole[x.trials] = observed_slopes(x.model, x.prediction(prediction))
        return whole
    return model.extension.observed_slopes(
        coordinates_from_pose(prediction.poses), model.amplitudes(prediction.theta), model.tests
    )[0]


def model_for_tests(knee: Knee, tests: Protocol | Laxity) -> LaxityModel:
    """The model of a knee under these tests, set up as for a fit to them.

    If the knee states the poses of an earlier fit, equilibria are searched for from these, also
    where the trials were measured.
    """
    trials = tests.protocol if isinstance(tests, Laxity) else tests
    model = LaxityModel(knee=knee, protocol=trials)
    return model.with_tests(tests) if isinstance(tests, Laxity) and not knee.poses else model
