"""What a drawing of the knee in three dimensions shows: surfaces, lines and the trials' poses."""

import numpy as np

from identknee.laxity.dominant import told_loads
from identknee.laxity.trial_words import setting_words
from identknee.mechanics.contact_places import distances
from identknee.mechanics.distance_field import DistanceField
from identknee.mechanics.equilibria import Lines
from identknee.mechanics.grood_suntay import coordinates_from_pose
from identknee.mechanics.ligament_tensions import ligament_tensions
from identknee.mechanics.placement import Placement, place
from identknee.model.effects.effect import MechanicalEffect
from identknee.model.laxity_model import LaxityModel
from identknee.model.mechanics_inputs import Setting
from identknee.model.prediction import Prediction
from identknee.report.page.few_triangles import Mesh, few_triangles
from identknee.runs.arrays import Array, IntArray, frozen
from identknee.runs.declare import array, declared, entry
from identknee.runs.outcome import Outcome
from identknee.subject.frames import Frame
from identknee.subject.knee import Knee
from identknee.subject.surface import Surface, joined

# Of femur and tibia as drawn; they have about twice as many triangles.
N_VERTICES = (720, 760)
# Places of the tibia that lie farther than this from the femur [mm] are not sent: the others shape
# the edge of the patch that touches it.
APART = 0.4


@declared
class SceneTrial:
    """One trial as it is drawn."""

    name: str = entry("Name of the trial")
    loads: str = entry("Its flexion and loads in words")
    outcome: Outcome = entry("How it ended")
    placement: Placement = entry("Placement of the tibia in the femur")
    coordinates: Array = array(
        "Lateral shift, anterior drawer, distraction [mm], varus, internal [deg]", "coordinate"
    )
    tensions: Array = array("Tension of each line; NaN without equilibrium", "line", unit="N")
    near: IntArray = array(
        "Which vertices of the tibia touch the femur or are less than `APART` from it",
        "touching",
        dtype=int,
    )
    depths: Array = array(
        "How deep these lie in the femur; negative where apart", "touching", unit="mm"
    )


@declared
class KneeScene:
    """A knee in every trial of a protocol, as a right knee whatever its side."""

    knee: Knee = entry("The subject")
    femur: Mesh = entry("Femoral cartilage, in the axes of poses")
    tibia: Mesh = entry("Tibial cartilage, both plateaus as one mesh")
    names: tuple[str, ...] = entry("Names of the m lines that carry the tensions")
    lines: Lines = entry("Their courses")
    missing_line: Array | None = entry(
        "Femoral end in femoral axes and tibial end in tibial axes [mm], shape ``(2, 3)``, of a "
        "line that the model lacks; None where none is shown"
    )
    trials: tuple[SceneTrial, ...] = entry("Its trials in the order of the protocol")


def model_scene(
    model: LaxityModel, theta: Array, *, missing_line: Array | None = None
) -> KneeScene:
    """The scene of what a model predicts, with the lines that its effects add or move.

    A trial without equilibrium stands in the last stable pose on the way to it. Springs that stand
    for more than a line, such as those of the menisci, are left out.

    Parameters
    ----------
    model
        Any laxity model.
    theta
        Its parameter vector, shape ``(p,)``.
    missing_line
        Femoral and tibial end of a line that the model lacks, in the common frame of the scanned
        pose [mm], shape ``(2, 3)``.

    Raises
    ------
    ValueError
        As `LaxityModel.predict`.
    """
    prediction, setting = model.predict(theta, derivatives=False), model.setting(theta)
    flexion = setting.flexion[model.paths.trial_node]
    lines = setting.measured_lines
    found = ligament_tensions(
        lines, flexion, prediction.poses, setting.stiffness, setting.reference_strain
    )
    tensions = np.where(prediction.is_converged[:, None], found.tensions, np.nan)
    drawn = np.flatnonzero(np.asarray(lines.transition) > 0.0)
    names = _line_names(model, theta)
    knee = model.knee
    femur = _drawn(knee.femur, knee.femur_frame, setting, 0)
    tibia = _drawn(joined(*knee.tibia), knee.tibia_frame, setting, 1)
    return KneeScene(
        knee=knee,
        femur=femur,
        tibia=tibia,
        names=tuple(names[i] for i in drawn),
        lines=_selected_lines(lines, drawn),
        missing_line=None if missing_line is None else _in_bones(knee, setting, missing_line),
        trials=_trials(model, prediction, setting, tensions[:, drawn], tibia),
    )


def _trials(
    model: LaxityModel, prediction: Prediction, setting: Setting, tensions: Array, tibia: Mesh
) -> tuple[SceneTrial, ...]:
    protocol, trials = model.protocol, []
    told = told_loads(protocol)
    flexion, (_, field) = setting.flexion[model.paths.trial_node], model.surfaces(setting)
    for i, (outcome, pose) in enumerate(zip(prediction.outcomes, prediction.poses, strict=True)):
        placement = place(float(flexion[i]), pose)
        near, depths = _contact(field, placement.to_femur(tibia.vertices))
        trials.append(
            SceneTrial(
                name=protocol.trials[i],
                loads=setting_words(float(protocol.flexion_deg[i]), told[i]),
                outcome=outcome,
                placement=placement,
                coordinates=coordinates_from_pose(pose),
                tensions=tensions[i],
                near=near,
                depths=depths,
            )
        )
    return tuple(trials)


def _drawn(surface: Surface, frame: Frame, setting: Setting, bone: int) -> Mesh:
    """The surface of femur (0) or tibia (1) in the axes of poses, with few triangles."""
    vertices = setting.as_measured_points(frame.to_local(surface.vertices), bone)
    return few_triangles(Surface(vertices=vertices, faces=surface.faces), N_VERTICES[bone])


def _contact(field: DistanceField, places: Array) -> tuple[IntArray, Array]:
    """Which places touch the femur or nearly do, and how deep they lie in it [mm]."""
    places = field.to_field(places)
    cell = np.floor((places - field.origin) / field.spacing)
    # The outermost cells of the grid lack the support of the spline.
    inner = (cell >= 1) & (cell <= np.array(field.coefficients.shape) - 3)
    index = np.flatnonzero(inner.all(axis=1))
    depths = -distances(field, places[index])[0]
    near = depths > -APART
    return index[near], depths[near]


def _in_bones(knee: Knee, setting: Setting, ends: Array) -> Array:
    """Femoral and tibial end of a line (2, 3) of the common frame, each in its bone's axes."""
    femoral, tibial = frozen(ends, 2, 3, name="missing_line")
    local = knee.femur_frame.to_local(femoral), knee.tibia_frame.to_local(tibial)
    return np.stack([setting.as_measured_points(x, bone) for bone, x in enumerate(local)])


def _line_names(model: LaxityModel, theta: Array) -> list[str]:
    """Names of all lines of a model, those that effects add called after what they belong to."""
    ligaments = [x.name for x in model.knee.ligaments]
    names, start = list(ligaments), 0
    setting, values = model.setting(theta, is_changed=False), model.amplitudes(theta)
    for effect in model.effects:
        part = slice(start, start + effect.parameters.n)
        start = part.stop
        if not isinstance(effect, MechanicalEffect):
            continue
        setting = effect.change(setting, values[part])
        for owner in setting.owner[len(names) :]:
            name = ligaments[owner] if owner >= 0 else effect.name.replace("_", " ")
            number = 1 + sum(x == name or x.startswith(f"{name} #") for x in names)
            names.append(name if number == 1 else f"{name} #{number}")
    return names


def _selected_lines(lines: Lines, index: IntArray) -> Lines:
    columns = ("femoral", "tibial", "reference_length", "transition", "wrap_offset", "wrap_place")
    return Lines(**{x: np.asarray(getattr(lines, x))[index] for x in columns})
