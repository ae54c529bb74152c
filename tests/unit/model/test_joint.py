"""A knee as arrays, and the cache of its distance field."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from energy_evaluation import field_values
from small_knee import BOTTOM, CENTRES, RADII, small_knee
from tolerances import CLOSED_FORM

from identknee.mechanics.pose import rotation_matrix
from identknee.model import laxity_model as module
from identknee.model.laxity_model import contact_geometry, contact_sheets
from identknee.runs.declare import Array
from identknee.subject.knee import Frame, Knee
from identknee.subject.reference import reference_knee


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for every test."""
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path)
    return tmp_path / "fields"


def _turned_tibia(knee: Knee) -> Knee:
    """The same scan, its tibial frame turned and set elsewhere."""
    rotation = rotation_matrix(0.3, -0.05, 0.2)
    return replace(knee, tibia_frame=Frame(origin=np.array([1.0, -2.0, 3.0]), axes=rotation.T))


def test_lengths_and_the_start_are_those_of_the_scanned_pose() -> None:
    knee = small_knee()
    joint = contact_geometry(knee)
    assert joint.start == pytest.approx(np.zeros(5), abs=CLOSED_FORM)
    assert joint.start_flexion == pytest.approx(0.0, abs=CLOSED_FORM)
    assert joint.lines.reference_length == pytest.approx(knee.reference_lengths)
    assert len(joint.contact.points) == sum(len(x.vertices) for x in knee.tibia)
    assert joint.contact.n_compartments == 2
    places = np.array([[0.0, BOTTOM[0], -9.0], [0.8, BOTTOM[1] + 1.0, 9.5]])
    assert field_values(joint.field, places) == pytest.approx([0.0, -1.0], abs=1e-4)


def test_the_scanned_pose_of_a_turned_tibia_is_where_its_frame_stands() -> None:
    knee = _turned_tibia(small_knee())
    joint = contact_geometry(knee)
    assert joint.start_flexion == pytest.approx(0.3, abs=CLOSED_FORM)
    assert joint.start[:2] == pytest.approx([-0.05, 0.2], abs=CLOSED_FORM)
    rotation = rotation_matrix(joint.start_flexion, *joint.start[:2])
    origin = rotation_matrix(joint.start_flexion, 0.0, 0.0) @ joint.start[2:]
    in_femur = joint.contact.points @ rotation.T + origin
    vertices = np.concatenate([x.vertices for x in knee.tibia])
    assert in_femur == pytest.approx(vertices, abs=1e-12 * 100)
    tibial = joint.lines.tibial @ rotation.T + origin
    assert tibial == pytest.approx(np.array([x.tibia for x in knee.ligaments]), abs=1e-12 * 100)


def test_sheets_are_in_their_bones_axes() -> None:
    knee = _turned_tibia(small_knee())
    (femur, faces), tibia = contact_sheets(knee)
    np.testing.assert_array_equal(femur, knee.femur.vertices)
    np.testing.assert_array_equal(faces, knee.femur.faces)
    back = knee.tibia_frame.to_common(tibia[1][0])
    assert back == pytest.approx(knee.tibia[1].vertices, abs=1e-12 * 100)


def test_without_a_formula_the_mesh_gives_the_distance() -> None:
    meshed = contact_geometry(replace(small_knee(), femur_distance=None))
    exact = contact_geometry(small_knee())
    rng = np.random.default_rng(0)
    below = CENTRES[rng.integers(0, 2, 200)] + rng.uniform([-3, -9, -3], [3, -7, 3], (200, 3))
    # Chords of 36 corners around a sphere of 8.5 mm lie up to 0.05 mm inside it.
    difference = field_values(meshed.field, below) - field_values(exact.field, below)
    assert np.abs(difference).max() < 0.07
    assert RADII.max() * (1 - np.cos(np.pi / 36)) < 0.05


def test_a_field_is_built_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = contact_geometry(small_knee())
    assert len(list(cache.iterdir())) == 1

    def never(*_: object, **__: object) -> None:
        raise AssertionError("the field was built again")

    monkeypatch.setattr(module, "build_field", never)
    again = contact_geometry(small_knee())
    np.testing.assert_array_equal(first.field.coefficients, again.field.coefficients)
    np.testing.assert_array_equal(first.field.reach, again.field.reach)
    assert again.field.spacing == first.field.spacing


def test_other_surfaces_have_other_fields(cache: Path) -> None:
    contact_geometry(small_knee())
    contact_geometry(replace(small_knee(), femur_distance=None))
    scaled = small_knee().femur.scaled(1.01)
    contact_geometry(replace(small_knee(), femur=scaled, femur_distance=None))
    assert len(list(cache.iterdir())) == 3


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 half a file", b"no archive at all"])
def test_a_broken_cache_is_built_anew(cache: Path, content: bytes) -> None:
    good = contact_geometry(small_knee())
    (path,) = cache.iterdir()
    path.write_bytes(content)
    again = contact_geometry(small_knee())
    np.testing.assert_array_equal(good.field.coefficients, again.field.coefficients)
    assert path.stat().st_size > 10_000


def test_half_a_cached_file_is_built_anew(cache: Path) -> None:
    contact_geometry(small_knee())
    (path,) = cache.iterdir()
    path.write_bytes(path.read_bytes()[:5000])
    contact_geometry(small_knee())
    assert path.stat().st_size > 10_000


def test_a_cache_that_cannot_be_written_is_no_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.write_text("not a folder")
    monkeypatch.setattr(module, "cache_folder", lambda: in_the_way)
    assert contact_geometry(small_knee()).field.coefficients.size > 0


def test_a_full_disk_leaves_nothing_half_written(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert contact_geometry(small_knee()).field.coefficients.size > 0
    assert list(cache.iterdir()) == []


def test_one_knee_has_one_joint() -> None:
    knee = small_knee()
    assert contact_geometry(knee) is contact_geometry(knee)
    assert contact_geometry(knee, 200) is not contact_geometry(knee)


def test_rims_are_those_of_the_surfaces() -> None:
    knee = small_knee()
    joint = contact_geometry(knee)
    middle: Array = np.array([[CENTRES[0, 0], BOTTOM[0], CENTRES[0, 2]]])
    # The dish is a square of half width 7.8 mm, its rim raised by the dish's depth.
    assert joint.tibial_rims[0].at(middle)[0] == pytest.approx(7.8, abs=1.2)
    assert joint.femoral_rim.at(middle)[0] > 5.0
    assert reference_knee().femur.boundary_edges.size > 0
