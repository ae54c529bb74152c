"""Insertions along and across the surface of a bone: normals of a sphere, files, refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import identknee as ik
from identknee.model.nuisances import insertion_covariance, insertions, surface_normal
from identknee.runs.errors import InputError, ValueRefused
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Knee, Uncertainty, with_stated_uncertainty
from identknee.subject.surface import Surface

ALONG, ACROSS = 4.0, 1.0


def _ball(centre: np.ndarray, radius: float) -> Surface:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Surface(vertices=np.asarray(ball.vertices) + centre, faces=np.asarray(ball.faces))


def _knee() -> Knee:
    """The reference knee on two balls whose surfaces hold the insertions of its ACL."""
    knee = ik.reference_knee()
    acl = knee.ligament("ACL")
    balls = (
        _ball(acl.femur + np.array([0.0, 20.0, 0.0]), 20.0),
        _ball(acl.tibia - np.array([0.0, 18.0, 24.0]), 30.0),
    )
    stated = Uncertainty(insertions_mm=ALONG, insertions_normal_mm=ACROSS)
    return replace(knee, bones=balls, uncertainty=stated)


def test_the_normal_of_a_ball_is_radial() -> None:
    centre = np.array([3.0, -2.0, 5.0])
    ball = _ball(centre, 25.0)
    for direction in np.random.default_rng(1).normal(size=(20, 3)):
        radial = direction / np.linalg.norm(direction)
        # Off the surface, inside and outside.
        for distance in (23.0, 25.0, 29.0):
            found = surface_normal(ball, centre + distance * radial)
            assert np.linalg.norm(found) == pytest.approx(1.0)
            assert np.degrees(np.arccos(found @ radial)) < 3.0


def test_the_normal_is_a_principal_axis_in_the_axes_of_the_bone() -> None:
    knee = _knee()
    for bone, outward in (("femur", [0.0, -1.0, 0.0]), ("tibia", [0.0, 0.6, 0.8])):
        covariance = insertion_covariance(knee, "ACL", bone)
        squares, axes = np.linalg.eigh(covariance)
        np.testing.assert_allclose(squares, [ACROSS**2, ALONG**2, ALONG**2], rtol=1e-9)
        frame = knee.femur_frame if bone == "femur" else knee.tibia_frame
        assert abs(axes[:, 0] @ (frame.axes @ outward)) > np.cos(np.radians(3.0))
    plain = knee.with_uncertainty(Uncertainty(insertions_mm=ALONG))
    np.testing.assert_array_equal(insertion_covariance(plain, "ACL", "femur"), ALONG**2 * np.eye(3))


def test_shifts_of_insertions_have_the_covariance_stated() -> None:
    knee = _knee()
    made = insertions(knee)
    spread = made.matrix * made.parameters.prior_sd
    whole = spread @ spread.T
    np.testing.assert_allclose(
        whole[3:6, 3:6], insertion_covariance(knee, knee.ligaments[0].name, "tibia"), atol=1e-9
    )


def test_bones_are_kept_with_a_subject(tmp_path: Path) -> None:
    knee = replace(_knee(), side="left")
    again = read_subject(write_subject(knee, tmp_path))
    assert again.bones is not None
    assert knee.bones is not None
    for one, other in zip(again.bones, knee.bones, strict=True):
        np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-5)
    assert again.uncertainty == knee.uncertainty
    for bone in ("femur", "tibia"):
        np.testing.assert_allclose(
            insertion_covariance(again, "ACL", bone),
            insertion_covariance(knee, "ACL", bone),
            atol=1e-4,
        )
    file = tmp_path / "subject.toml"
    text = file.read_text()
    rows = f"insertions_mm = {ALONG}\ninsertions_normal_mm = {ACROSS}\n"
    assert rows in text
    file.write_text(
        text.replace(rows, f"insertions_mm = {{ tangential = {ALONG}, normal = {ACROSS} }}\n")
    )
    assert read_subject(tmp_path).uncertainty == knee.uncertainty
    file.write_text(text.replace('femur_bone = "femur_bone.ply"\n', ""))
    with pytest.raises(InputError):
        read_subject(tmp_path)


def test_an_error_across_a_bone_needs_one_along_it_and_the_bone() -> None:
    with pytest.raises(ValueRefused):
        Uncertainty(insertions_normal_mm=1.0)
    stated = with_stated_uncertainty(Uncertainty(), "insertions=4mm,insertions_normal=1mm")
    knee = ik.reference_knee().with_uncertainty(stated)
    with pytest.raises(ValueRefused, match="femur_bone"):
        insertions(knee)


def test_insertions_of_the_measured_knee_lie_on_its_bones() -> None:
    """Half within 2 mm of the femur and 1 mm of the tibia, as its scan says."""
    knee = ik.example("s192803_bundles")
    assert knee.bones is not None
    for i, (bone, most) in enumerate((("femur", 2.0), ("tibia", 1.2))):
        whole = trimesh.Trimesh(knee.bones[i].vertices, knee.bones[i].faces, process=False)
        places = np.array([getattr(x, bone) for x in knee.ligaments])
        distance = trimesh.proximity.ProximityQuery(whole).on_surface(places)[1]  # type: ignore[no-untyped-call]
        assert np.median(distance) < most
        assert distance.max() < 4.0
