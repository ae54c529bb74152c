"""The knee in three dimensions as HTML for a page that is read offline."""

import json
from typing import Any

import numpy as np
from markupsafe import Markup
from scipy.spatial import cKDTree

from identknee.calibrate.fit import load_start
from identknee.checks.usable_trials import table_model
from identknee.laxity.protocol import Protocol, nominal_loads
from identknee.laxity.table import Laxity
from identknee.laxity.trial_words import setting_words
from identknee.mechanics.equilibria import Continuation, LineLigaments
from identknee.mechanics.ligament_tensions import ligament_tensions, line_courses, wrapped_lines
from identknee.mechanics.pose import Placement, coordinates_from_pose, place
from identknee.model.candidate_laxity import continued_from_own_poses
from identknee.model.contact_loads import contact_values, meniscus_values
from identknee.model.effects.effect import MechanicalEffect
from identknee.model.effects.facts import cause_label
from identknee.model.laxity_model import Contact, LaxityModel, model_for_tests
from identknee.model.mechanics_inputs import MechanicsInputs
from identknee.model.prediction import Prediction
from identknee.report.page.markup import beside, environment
from identknee.report.presenter import presenter_of, settings_of
from identknee.report.results import Findings
from identknee.report.scene import distance_from_femur
from identknee.runs.declare import Array, IntArray, array, declared, entry, frozen, frozen_integers
from identknee.runs.record import Outcome
from identknee.subject.folder import read_subject
from identknee.subject.knee import Frame, Knee
from identknee.subject.surface import Surface, joined
from identknee.verbs.answer import Answer
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.fit import Calibration

ROUNDS = 12  # of clustering; the patches hardly change after
DECIMALS = 2  # of a mm


@declared
class Mesh:
    """A triangle mesh."""

    vertices: Array = array("Vertices", "vertex", "axis", unit="mm")
    faces: IntArray = array("Vertex numbers of the triangles", "triangle", "axis", dtype=int)


def few_triangles(surface: Surface, number: int) -> Mesh:
    """The surface with about `number` vertices and twice as many triangles, rounded to 0.01 mm.

    Vertices are clustered into patches of nearly equal area, as in [1]_. Each patch becomes a
    vertex, at its centroid or, where it has a part of the rim, in the middle of that part; each
    triangle whose corners lie in three patches joins them. A surface that has no more vertices than
    asked for is only rounded.

    References
    ----------
    .. [1] Valette and Chassery (2004), Comput. Graph. Forum 23(3), 381-389.
           https://doi.org/10.1111/j.1467-8659.2004.00769.x
    """
    vertices, faces = surface.vertices, surface.faces
    if len(vertices) > number:
        patch, vertices = _patches(surface, number)
        corners = patch[faces]
        a, b, c = corners.T
        between = corners[(a != b) & (b != c) & (c != a)]
        _, first = np.unique(np.sort(between, axis=1), axis=0, return_index=True)
        faces = frozen_integers(between[np.sort(first)])
    return Mesh(vertices=vertices.round(DECIMALS) + 0.0, faces=faces)


def _patches(surface: Surface, number: int) -> tuple[IntArray, Array]:
    """The patch of every vertex, and the place of every patch [mm]."""
    vertices = surface.vertices
    # A vertex without a triangle has almost no weight.
    weight = np.maximum(surface.vertex_areas, 1e-9 * surface.areas.sum())
    # Seeds evenly along the surface's area, in an order that keeps neighbours together.
    order = cKDTree(vertices).indices
    passed = np.cumsum(weight[order]) - 0.5 * weight[order]
    wanted = (np.arange(number) + 0.5) * weight.sum() / number
    # The last vertex may have more than a whole share of the area.
    seeds = order[np.minimum(np.searchsorted(passed, wanted), len(order) - 1)]
    centroids = vertices[np.unique(seeds)]
    for _ in range(ROUNDS):
        nearest = cKDTree(centroids).query(vertices)[1]
        used, patch = np.unique(nearest, return_inverse=True)
        area = np.bincount(patch, weight)
        moment = [np.bincount(patch, weight * x, len(used)) for x in vertices.T]
        centroids = np.stack(moment, axis=1) / area[:, None]
    # Patches at the rim reach up to it.
    rim = np.unique(surface.boundary_edges)
    count = np.bincount(patch[rim], minlength=len(used))
    sums = [np.bincount(patch[rim], x, len(used)) for x in vertices[rim].T]
    at_rim = count > 0
    centroids[at_rim] = (np.stack(sums, axis=1) / np.maximum(count, 1)[:, None])[at_rim]
    return np.asarray(patch, np.int64), centroids


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
    contact_N: Array = array(  # noqa: N815 - the unit
        "Contact force of the medial and the lateral compartment; NaN without equilibrium",
        "compartment",
        unit="N",
    )
    meniscus_N: Array = array(  # noqa: N815 - the unit
        "Force of the medial and the lateral meniscus, 0 without; NaN without equilibrium",
        "compartment",
        unit="N",
    )
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
    names: tuple[str, ...] = entry(
        "What each of the m lines that carry the tensions belongs to: lines of one name are one "
        "ligament"
    )
    lines: LineLigaments = entry("Their courses")
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
        lines=lines.take(drawn),
        missing_line=None if missing_line is None else _in_bones(knee, setting, missing_line),
        trials=_trials(model, prediction, setting, tensions[:, drawn], tibia),
    )


def _trials(
    model: LaxityModel,
    prediction: Prediction,
    setting: MechanicsInputs,
    tensions: Array,
    tibia: Mesh,
) -> tuple[SceneTrial, ...]:
    protocol, trials = model.protocol, []
    main_loads = nominal_loads(protocol)
    contact, menisci = (x(prediction)[:, :, 0] for x in (contact_values, meniscus_values))
    flexion, (_, field) = setting.flexion[model.paths.trial_node], model.surfaces(setting)
    for i, (outcome, pose) in enumerate(zip(prediction.outcomes, prediction.poses, strict=True)):
        placement = place(float(flexion[i]), pose)
        depths = -distance_from_femur(field, placement.to_femur(tibia.vertices))
        near = np.flatnonzero(depths > -APART)
        trials.append(
            SceneTrial(
                name=protocol.trials[i],
                loads=setting_words(float(protocol.flexion_deg[i]), main_loads[i]),
                outcome=outcome,
                placement=placement,
                coordinates=coordinates_from_pose(pose),
                tensions=tensions[i],
                contact_N=contact[i],
                meniscus_N=menisci[i],
                near=near,
                depths=depths[near],
            )
        )
    return tuple(trials)


def _drawn(surface: Surface, frame: Frame, setting: MechanicsInputs, bone: int) -> Mesh:
    """The surface of femur (0) or tibia (1) in the axes of poses, with few triangles."""
    vertices = setting.as_measured_points(frame.to_local(surface.vertices), bone)
    return few_triangles(Surface(vertices=vertices, faces=surface.faces), N_VERTICES[bone])


def _in_bones(knee: Knee, setting: MechanicsInputs, ends: Array) -> Array:
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
        own = cause_label(effect.name)
        names += [ligaments[x] if x >= 0 else own for x in setting.owner[len(names) :]]
    return names


MICROMETRES = 1000.0  # in a mm
MARGIN = 8.0  # mm around what is drawn
ROOM_FOR_NAMES = np.array([0.0, 16.0, 0.0])  # mm below it, where the names of ligaments stand
SHAFT = 38.0  # mm, length of the strokes that stand for the bones' shafts


def viewer_html(scene: KneeScene) -> Markup:
    """HTML of the interactive knee: a fragment that needs `Plotly` on its page and nothing else.

    A left knee is drawn as a left one. A page may hold several of them.
    """
    style, code = beside("viewer.css", "viewer.js")
    data = json.dumps(_data(scene), separators=(",", ":"), allow_nan=False)
    owners, forces = _owners(scene)
    knee, n = scene.knee, len(scene.trials)
    sentences = [
        f"The {knee.side} knee {knee.name} in {n} trials, its ligaments coloured by force."
    ]
    if np.isfinite(forces).any():
        trial, line = np.unravel_index(np.nanargmax(forces), forces.shape)
        sentences.append(
            f"The largest force is {forces[trial, line]:.0f} N, of {owners[line]} in "
            f"{scene.trials[trial].name}."
        )
    lost = [x.name for x in scene.trials if x.outcome is not Outcome.CONVERGED]
    if lost:
        sentences.append(f"{len(lost)} without equilibrium, the first of them {lost[0]}.")
    return Markup(
        environment()
        .get_template("viewer.html")
        .render(
            style=style,
            code=code,
            # Nothing in the data can end the element that holds them.
            data=Markup(data.replace("<", "\\u003c")),
            words=" ".join(sentences),
            last=len(scene.trials) - 1,
            hidden=" hidden" if len(scene.trials) == 1 else "",
        )
    )


def _owners(scene: KneeScene) -> tuple[tuple[str, ...], Array]:
    """Every ligament once, and the force of all its lines in each trial [N]."""
    owners = tuple(dict.fromkeys(scene.names))
    tensions = np.array([x.tensions for x in scene.trials]).reshape(len(scene.trials), -1)
    is_of = np.array(scene.names)[:, None] == np.array(owners)
    return owners, tensions @ is_of.astype(np.float64)


def _data(scene: KneeScene) -> dict[str, Any]:
    """What the drawing is made from, of the knee's own side."""
    mirror = np.array([1.0, 1.0, -1.0 if scene.knee.side == "left" else 1.0])
    lines = scene.lines
    owners, forces = _owners(scene)
    depths = np.concatenate([x.depths for x in scene.trials])
    missing = scene.missing_line
    courses = [line_courses(lines, x.placement) for x in scene.trials]
    # Corners between the ends in every trial, of lines around obstacles.
    ways = {
        i: [_rounded(own[i][1:-1] * mirror, 2) for own in courses]
        for i in wrapped_lines(lines).tolist()
    }
    return {
        "lateral": mirror[2],
        "femur": _mesh(scene.femur, mirror),
        "tibia": _mesh(scene.tibia, mirror),
        "ligaments": owners,
        "lines": [
            {
                "of": owners.index(name),
                "femoral": _rounded(lines.femoral[i] * mirror, 3),
                "tibial": _rounded(lines.tibial[i] * mirror, 3),
                "lift": _rounded(np.asarray(lines.wrap_offset)[i] * mirror[2], 3),
                "place": _rounded(np.asarray(lines.wrap_place)[i], 4),
                "ways": ways.get(i),
            }
            for i, name in enumerate(scene.names)
        ],
        "missing": None if missing is None else _rounded(missing * mirror, 3),
        "shafts": _rounded(_shafts(scene) * mirror, 2),
        "box": _rounded(_box(scene, mirror), 1),
        "force": float(np.nanmax(np.abs(forces), initial=1.0)),
        "depth": float(np.max(depths, initial=0.01).round(2)),
        "trials": [_trial(x, own, mirror) for x, own in zip(scene.trials, forces, strict=True)],
    }


def _mesh(mesh: Mesh, mirror: Array) -> dict[str, Any]:
    x, y, z = (mesh.vertices * mirror).T.tolist()
    i, j, k = (mesh.faces if mirror[2] > 0.0 else mesh.faces[:, ::-1]).T.tolist()
    return {"x": x, "y": y, "z": z, "i": i, "j": j, "k": k}


def _trial(trial: SceneTrial, forces: Array, mirror: Array) -> dict[str, Any]:
    placement = trial.placement
    is_converged = trial.outcome is Outcome.CONVERGED
    return {
        "name": trial.name,
        "loads": trial.loads,
        "outcome": None if is_converged else trial.outcome.sentence,
        # A mirror before and after leaves a rotation.
        "rotation": _rounded(mirror[:, None] * placement.rotation * mirror, 8),
        "translation": _rounded(placement.translation * mirror, 5),
        "coordinates": _rounded(trial.coordinates, 2),
        "forces": [None if np.isnan(x) else round(float(x), 2) for x in forces],
        "near": trial.near.tolist(),
        "depths": np.round(MICROMETRES * trial.depths).astype(int).tolist(),
    }


def _shafts(scene: KneeScene) -> Array:
    """Ends of a stroke up the femur and of one down the tibia [mm], shape ``(2, 2, 3)``."""
    top = scene.femur.vertices[:, 1].max()
    bottom = scene.tibia.vertices[:, 1].min()
    ends = [
        [[0.0, top, 0.0], [0.0, top + SHAFT, 0.0]],
        [[0.0, bottom, 0.0], [0, bottom - SHAFT, 0]],
    ]
    return np.array(ends)


def _box(scene: KneeScene, mirror: Array) -> Array:
    """Lowest and highest corner of all that is drawn in any trial [mm], shape ``(2, 3)``."""
    missing = np.zeros((0, 2, 3)) if scene.missing_line is None else scene.missing_line[None]
    shafts = _shafts(scene)
    femoral = [scene.femur.vertices, scene.lines.femoral, missing[:, 0], shafts[0]]
    tibial = [scene.tibia.vertices, scene.lines.tibial, missing[:, 1], shafts[1]]
    moving = np.concatenate(tibial)
    places = np.concatenate([*femoral, *(x.placement.to_femur(moving) for x in scene.trials)])
    seen = places * mirror
    return np.stack([seen.min(axis=0) - MARGIN - ROOM_FOR_NAMES, seen.max(axis=0) + MARGIN])


def _rounded(values: Array, decimals: int) -> Any:
    """Numbers as nested lists, short in the file."""
    return (np.round(values, decimals) + 0.0).tolist()


EXTENDED, FITTED = "extended", "fitted.toml"


def scene_of(findings: Findings, knee: Knee) -> KneeScene | None:
    """The knee as a diagnosis extended it, else as it was fitted, else as it was simulated.

    None where no result says in which trials it is loaded.
    """
    for result in findings.of("diagnose", "fit", "demo", "simulate"):
        protocol = result.protocol
        if protocol is None:
            continue
        extended = result.folder / EXTENDED
        if result.verb == "diagnose" and extended.is_dir():
            model = model_for_tests(read_subject(extended), _tests_of(result.answer, protocol))
            theta = load_start(str(extended / FITTED), model.parameters)
            line = presenter_of(result.answer).missing_line(result.answer, model.knee)
            # Where the line became a structure of the knee, it is among its ligaments.
            is_own = any(x.lines for x in model.knee.effects)
            return model_scene(model, theta, missing_line=None if is_own else line)
        if (found := scene_at(result.answer, knee, protocol)) is not None:
            return found
    return None


def scene_at(answer: Answer, knee: Knee, protocol: Protocol) -> KneeScene | None:
    """The knee at the parameter set of an answer; None where it has none of this knee."""
    if (values := answer.parameter_set) is None:
        return None
    model = answered_model(answer, knee, protocol)
    if tuple(values) != model.parameters.names:
        return None
    parameters = np.array(list(values.values()))
    if knee.poses and not isinstance(answer, Calibration):
        model = continued_from_own_poses(model, parameters)
    return model_scene(model, parameters)


def _tests_of(answer: Answer, protocol: Protocol) -> Protocol | Laxity:
    """The measured trials of a diagnosis, else the protocol."""
    if not isinstance(answer, Diagnosis) or answer.trials is None:
        return protocol
    own = answer.trials
    return Laxity(protocol=protocol, coordinates=own.coordinates, zero=own.zero)


def answered_model(answer: Answer, knee: Knee, protocol: Protocol) -> LaxityModel:
    """The model of which an answer holds a parameter set, set up as when it was found.

    A fit to measured laxity may keep another pattern of grouped bundles than the knee, and begins
    at measured poses; at the same parameters another model has other forces.
    """
    settings = settings_of(answer)
    continuation: Continuation = settings.get("continuation") or "continuation"
    if isinstance(answer, Calibration):
        return table_model(knee, answer.data, continuation)[0]
    contact: Contact = settings.get("contact") or "field"
    return LaxityModel(knee=knee, protocol=protocol, continuation=continuation, contact=contact)
