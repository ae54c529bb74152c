"""A knee in the mirror moves as in the mirror, and a left knee is read as a right one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from energy_evaluation import SCALE, Evaluator, ligaments_of, random_parameters
from hypothesis import given
from hypothesis import strategies as st
from small_knee import small_knee, small_protocol
from tolerances import DERIVATIVE, SAME_POSE

from identknee.mechanics.distance_field import DistanceField, _near, _reach
from identknee.mechanics.equilibria import ContactPoints, LineLigaments
from identknee.model import laxity_model as module
from identknee.model.laxity_model import ContactGeometry, LaxityModel
from identknee.model.prediction import Prediction
from identknee.subject.folder import read_subject, write_subject

MIRROR = np.array([1.0, 1.0, -1.0])
# Varus and internal rotation turn round, and so does z.
OF_POSE = np.array([-1.0, -1.0, 1.0, 1.0, -1.0])


@pytest.fixture(scope="module")
def mirrored(reference_model: LaxityModel) -> ContactGeometry:
    here = reference_model.joint
    field = here.field
    last = field.origin + field.spacing * (np.array(field.coefficients.shape) - 1)
    coefficients = field.coefficients[:, :, ::-1]
    reach = _reach(coefficients)
    return replace(
        here,
        field=DistanceField(
            coefficients=coefficients,
            reach=reach,
            near=_near(reach),
            origin=np.r_[field.origin[:2], -last[2]],
            spacing=field.spacing,
        ),
        contact=ContactPoints(
            points=here.contact.points * MIRROR,
            areas=here.contact.areas,
            compartment=here.contact.compartment,
        ),
        lines=LineLigaments(
            femoral=here.lines.femoral * MIRROR,
            tibial=here.lines.tibial * MIRROR,
            reference_length=here.lines.reference_length,
        ),
    )


@given(seed=st.integers(0, 2**32 - 1), trial=st.integers(0, 62))
def test_energy_and_force_are_those_of_the_mirror(
    reference_model: LaxityModel,
    reference_prediction: Prediction,
    mirrored: ContactGeometry,
    seed: int,
    trial: int,
) -> None:
    rng = np.random.default_rng(seed)
    flexion = float(np.radians(reference_model.protocol.flexion_deg[trial]))
    pose = reference_prediction.poses[trial] + rng.normal(0.0, 0.5, 5) / SCALE
    load = rng.normal(0.0, 50.0, 5) * SCALE
    ligaments = ligaments_of(reference_model, random_parameters(reference_model, rng))
    there = ligaments.copy()
    there.femoral, there.tibial = mirrored.lines.femoral, mirrored.lines.tibial
    found = Evaluator(mirrored)(flexion, pose * OF_POSE, there, load * OF_POSE)
    expected = Evaluator(reference_model.joint)(flexion, pose, ligaments, load)
    assert found.energy == pytest.approx(expected.energy, rel=DERIVATIVE)
    size = np.abs(expected.gradient / SCALE).max()
    difference = found.gradient * OF_POSE - expected.gradient
    assert np.abs(difference / SCALE).max() <= DERIVATIVE * max(size, 1e3)
    assert found.touching == expected.touching


def test_a_left_knee_on_disk_is_the_mirror_and_reads_as_the_right_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path / "cache")
    right = small_knee()
    write_subject(right, tmp_path / "right")
    write_subject(replace(right, side="left"), tmp_path / "left")
    knees = [read_subject(tmp_path / side) for side in ("right", "left")]
    assert [x.side for x in knees] == ["right", "left"]
    models = [LaxityModel(knee=x, protocol=small_protocol()) for x in knees]
    found = [x.predict(x.parameters.center) for x in models]
    assert all(x.all_converged for x in found)
    difference = (found[0].poses - found[1].poses) * SCALE
    assert np.abs(difference).max() <= SAME_POSE
    assert found[1].coordinates == pytest.approx(found[0].coordinates, abs=1e-7)


def test_mirrored_twice_is_the_knee_itself() -> None:
    knee = small_knee()
    twice = knee.mirrored().mirrored()
    np.testing.assert_array_equal(twice.femur.vertices, knee.femur.vertices)
    np.testing.assert_array_equal(twice.femur.normals, knee.femur.normals)
    np.testing.assert_array_equal(twice.tibia_frame.axes, knee.tibia_frame.axes)
    points = np.random.default_rng(0).normal(0.0, 10.0, (50, 3))
    assert twice.femur_distance is not None
    assert knee.femur_distance is not None
    np.testing.assert_array_equal(twice.femur_distance(points), knee.femur_distance(points))
