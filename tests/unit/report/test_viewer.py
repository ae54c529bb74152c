"""The knee in three dimensions: its scene agrees with the model, its HTML is small and safe."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bundled_knee import bundled_knee
from posed_knees import NAMES, posed_reference
from wrapped_knee import wrapped_knee

from identknee.laxity.protocol import Protocol, load_protocol
from identknee.laxity.trial_words import setting_words
from identknee.mechanics.contact_points import contact_places
from identknee.mechanics.distance_field import ContactLaw
from identknee.mechanics.ligament_tensions import line_lengths
from identknee.mechanics.pose import pose_from_coordinates
from identknee.model.effects.library import effect_named
from identknee.model.laxity_model import LaxityModel
from identknee.model.line_loads import tensions_of
from identknee.model.prediction import Prediction
from identknee.report.page.viewer import KneeScene, model_scene, scene_of, viewer_html
from identknee.report.results import Findings, result_of
from identknee.runs.declare import Array
from identknee.runs.record import Outcome
from identknee.verbs.fit import fit
from identknee.verbs.simulate import simulate

LIMIT = 600_000  # bytes of a scene
PLACES = 1e-3  # mm, as near as drawn places are to those of the model
# Depth of a patch's deepest point [mm]: both sets of points sample it every 1.3 to 1.7 mm.
SAMPLED = 0.1
OFF_CENTRE = 1.0  # mm, of a patch of about 10 mm


def few_trials(n: int = 5) -> Protocol:
    protocol = load_protocol("seed63")
    return protocol.select(np.linspace(0, protocol.n - 1, n).round().astype(int))


def data_in(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found.group(1))
    return data


def moved(trial: dict[str, Any], points: Any) -> Array:
    places: Array = np.array(points) @ np.array(trial["rotation"]).T + trial["translation"]
    return places


def vertices(mesh: dict[str, Any]) -> Array:
    return np.stack([mesh[axis] for axis in "xyz"], axis=1)


@pytest.fixture(scope="module")
def scene(reference_model: LaxityModel) -> KneeScene:
    return model_scene(reference_model, reference_model.parameters.center)


@pytest.fixture(scope="module")
def left_model() -> LaxityModel:
    return LaxityModel(knee=posed_reference(), protocol=few_trials(3))


def test_forces_and_poses_are_those_of_the_model(
    scene: KneeScene, reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    forces = np.array([x.tensions for x in scene.trials])
    assert np.array_equal(forces, tensions_of(reference_model, reference_prediction))
    assert scene.names == tuple(x.name for x in reference_model.knee.ligaments)
    coordinates = np.array([x.coordinates for x in scene.trials])
    assert np.allclose(coordinates, reference_prediction.coordinates, rtol=1e-12)


def test_contact_is_where_the_model_has_it(
    scene: KneeScene, reference_model: LaxityModel, reference_prediction: Prediction
) -> None:
    joint, law = reference_model.joint, ContactLaw()
    for i in (0, 31, 62):
        flexion = float(np.radians(reference_model.protocol.flexion_deg[i]))
        pose = reference_prediction.poses[i]
        found = contact_places(joint.contact, joint.field, np.array([flexion]), pose[None])
        depths = found.force / (law.modulus * joint.contact.areas[found.index])
        assert scene.trials[i].depths.max() == pytest.approx(depths.max(), abs=SAMPLED)
        drawn = scene.tibia.vertices[scene.trials[i].near[scene.trials[i].depths > 0.0]]
        points = joint.contact.points[found.index]
        for side in (-1.0, 1.0):
            one, other = (x[side * x[:, 2] > 0.0].mean(axis=0) for x in (drawn, points))
            assert np.linalg.norm(one - other) < OFF_CENTRE


def test_scene_is_small_and_the_surfaces_are_few_triangles(scene: KneeScene) -> None:
    page = viewer_html(scene)
    assert len(page.encode()) < LIMIT
    assert len(scene.femur.faces) + len(scene.tibia.faces) <= 3000


def test_drawn_places_are_those_of_the_placement(scene: KneeScene) -> None:
    data = data_in(viewer_html(scene))
    for trial, drawn in zip(scene.trials, data["trials"], strict=True):
        places = moved(drawn, vertices(data["tibia"]))
        assert np.abs(places - trial.placement.to_femur(scene.tibia.vertices)).max() < PLACES
        low, high = np.array(data["box"])
        assert (places > low).all()
        assert (places < high).all()


def test_left_knee_is_drawn_as_a_left_one(left_model: LaxityModel) -> None:
    theta, ends = left_model.parameters.center, np.array([[0.0, 5.0, 30.0], [10.0, -40.0, 25.0]])
    knee = left_model.knee
    ends = np.stack([knee.femur_frame.to_common(ends[0]), knee.tibia_frame.to_common(ends[1])])
    left = data_in(viewer_html(model_scene(left_model, theta, missing_line=ends)))
    right_model = replace(left_model, knee=replace(knee, side="right"))
    right = data_in(viewer_html(model_scene(right_model, theta, missing_line=ends)))
    assert left["ligaments"] == [*NAMES, "oblique"]
    mirror = np.array([1.0, 1.0, -1.0])
    assert (left["lateral"], right["lateral"]) == (-1.0, 1.0)
    for one, other in zip(left["trials"], right["trials"], strict=True):
        assert one["coordinates"] == other["coordinates"]
        assert np.linalg.det(one["rotation"]) == pytest.approx(1.0, abs=1e-6)
        mirrored = moved(other, vertices(right["tibia"])) * mirror
        assert np.abs(moved(one, vertices(left["tibia"])) - mirrored).max() < PLACES
    assert np.allclose(np.array(left["missing"]), np.array(right["missing"]) * mirror)
    faces = [[x["femur"][axis] for axis in "ijk"] for x in (left, right)]
    assert faces[0] == faces[1][::-1]


def test_lines_of_effects_are_drawn_under_their_names(reference_model: LaxityModel) -> None:
    knee = reference_model.knee
    effects = [effect_named(knee, x) for x in ("bundles", "meniscus", "anterolateral")]
    model = replace(reference_model, protocol=few_trials(2)).with_effects(effects)
    theta = np.array(model.parameters.center)
    theta[list(model.parameters.names).index("anterolateral.stiffness_kN")] = 2.0
    drawn = model_scene(model, theta)
    own = [x.name for x in knee.ligaments]
    assert drawn.names == (*own, *own, "anterolateral structure")
    assert all(len(x.tensions) == len(drawn.names) for x in drawn.trials)
    # A ligament of two lines has one name and one force, which is that of both.
    data = data_in(viewer_html(drawn))
    assert data["ligaments"] == [*own, "anterolateral structure"]
    assert [x["of"] for x in data["lines"]] == [0, 1, 2, 3, 0, 1, 2, 3, 4]
    forces = np.array([x["forces"] for x in data["trials"]])
    expected = tensions_of(model, model.predict(theta, derivatives=False))
    np.testing.assert_allclose(forces[:, : len(own)], expected, atol=0.01)


def test_a_fit_is_drawn_with_the_model_that_it_was_made_with() -> None:
    protocol = few_trials()
    measured = replace(
        protocol, flexion_deg=protocol.flexion_deg + 0.1 * np.arange(protocol.n, dtype=float)
    )
    whole = bundled_knee()
    laxity = simulate(whole, measured, noise="0.3mm,0.3deg").noisy
    assert laxity is not None
    # At these strains trials have no equilibrium, so that the fit keeps other ones of its bundles.
    strains = [-9.0 if x.name == "MCLp" else -12.0 for x in whole.ligaments]
    knee = whole.with_ligaments(
        [replace(x, reference_strain_pct=e) for x, e in zip(whole.ligaments, strains, strict=True)]
    )
    answer = fit(knee, laxity, noise="0.3mm,0.3deg", budget=1, more_starts=0)
    found = scene_of(Findings(subject=knee.name, results=(result_of(answer),)), knee)
    assert found is not None
    forces = np.array([x.tensions for x in found.trials])
    np.testing.assert_array_equal(forces, answer.tension_N)
    other = LaxityModel(knee=knee, protocol=measured).predict(answer.theta, derivatives=False)
    assert np.nanmax(np.abs(other.coordinates - answer.coordinates)) > 0.1


def test_pushed_line_bends(reference_model: LaxityModel) -> None:
    wrapping = effect_named(reference_model.knee, "mcl_wrapping")
    model = replace(reference_model, protocol=few_trials(2)).with_effects([wrapping])
    theta = np.array(model.parameters.center)
    theta[-1] = 6.0
    lifts = [x["lift"] for x in data_in(viewer_html(model_scene(model, theta)))["lines"]]
    assert sorted(lifts) == [-6.0, *[0.0] * (len(lifts) - 1)]


def test_lines_around_obstacles_are_drawn_as_they_run() -> None:
    """Corners between the ends, whose chain is as long as the ligament."""
    model = LaxityModel(knee=wrapped_knee(), protocol=few_trials(2))
    made = model_scene(model, np.array(model.parameters.center))
    data = data_in(viewer_html(made))
    lines = {data["ligaments"][x["of"]]: x for x in data["lines"]}
    assert lines["ACL"]["ways"] is None
    setting = model.setting(np.array(model.parameters.center))
    for k, trial in enumerate(made.trials):
        chain = np.array(
            [
                lines["MCL"]["femoral"],
                *lines["MCL"]["ways"][k],
                trial.placement.to_femur(np.array(lines["MCL"]["tibial"])[None])[0],
            ]
        )
        assert len(chain) > 3
        coordinates = pose_from_coordinates(trial.coordinates[None])[0]
        flexion = float(np.radians(model.protocol.flexion_deg[k]))
        wanted = line_lengths(setting.measured_lines, flexion, coordinates)[3]
        assert np.linalg.norm(np.diff(chain, axis=0), axis=1).sum() == pytest.approx(
            wanted, abs=0.02
        )


def test_offset_of_flexion_turns_the_tibia(reference_model: LaxityModel) -> None:
    offset = effect_named(reference_model.knee, "flexion_offset")
    model = replace(reference_model, protocol=few_trials(2)).with_effects([offset])
    theta = np.append(model.parameters.center[:-1], 4.0)
    for trial, stated in zip(
        model_scene(model, theta).trials, model.protocol.flexion_deg, strict=True
    ):
        rotation = trial.placement.rotation
        flexion = np.degrees(np.arctan2(rotation[0, 1], rotation[1, 1]))
        assert flexion == pytest.approx(stated + 4.0, abs=1e-9)


def test_trial_without_equilibrium_says_why(reference_model: LaxityModel) -> None:
    theta = np.array(reference_model.parameters.center)
    theta[: len(reference_model.knee.ligaments)] = 0.0
    model = replace(reference_model, protocol=few_trials(2))
    page = viewer_html(model_scene(model, theta))
    data = data_in(page)
    for trial in data["trials"]:
        assert trial["outcome"] == Outcome.UNCONSTRAINED.sentence
        assert trial["forces"] == [None] * len(data["lines"])
    assert "2 without equilibrium" in page


def test_names_cannot_break_the_page(reference_model: LaxityModel) -> None:
    knee = reference_model.knee
    named = replace(
        knee,
        name="</script><b>$words & co",
        ligaments=tuple(replace(x, name=f"<i>{k}</script>") for k, x in enumerate(knee.ligaments)),
    )
    model = replace(reference_model, knee=named, protocol=few_trials(2))
    page = viewer_html(model_scene(model, model.parameters.center))
    assert page.count("</script>") == 2
    assert "<b>" not in page.replace('<b class="kv-loads">', "")
    assert data_in(page)["ligaments"][0] == "<i>0</script>"


def test_fragment_asks_for_nothing_from_elsewhere(scene: KneeScene) -> None:
    page = viewer_html(scene)
    assert not re.search(r"https?:|src=|url\(|@import", page)
    assert not re.search(r"\$(style|data|code|words|last|hidden)", page)


def test_loads_in_words() -> None:
    assert setting_words(90.0, np.zeros(5)) == "Flexion 90°, unloaded"
    both = setting_words(12.5, np.array([5.0, 0.0, -100.0, 0.0, 0.0]))
    assert both == "Flexion 12.5°, internal moment 5 N·m and posterior force 100 N"
