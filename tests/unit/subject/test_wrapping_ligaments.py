"""Ligaments around obstacles: their files, OpenSim models, left knees, and what is refused."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_knee import small_protocol
from wrapped_knee import OBSTACLES, wrapped_knee

import identknee as ik
from identknee.blind.experiment import experiment_of
from identknee.model.laxity_model import LaxityModel, lines_in_bones
from identknee.runs.errors import InputError, ValueRefused
from identknee.subject.check import check_geometry
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Knee, Side
from identknee.subject.ligament import Obstacle
from identknee.subject.opensim import import_opensim, imported_knee, straightened
from identknee.subject.opensim_export import write_opensim
from identknee.subject.opensim_wrap import shortest_way


def of_lines(knee: Knee) -> np.ndarray:
    return np.asarray(lines_in_bones(knee).table())


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_subject_file_holds_the_obstacles(tmp_path: Path, side: Side) -> None:
    knee = replace(wrapped_knee(), side=side)
    found = read_subject(write_subject(knee, tmp_path / "subject"))
    np.testing.assert_allclose(of_lines(found), of_lines(knee), atol=1e-9)
    text = (tmp_path / "subject" / "subject.toml").read_text("utf-8")
    assert text.count("[ligaments.wrap]") == len(OBSTACLES)
    # A left knee's file has the scan's own side.
    assert ("axis = [2.0, 0.0, -0.3]" in text) == (side == "left")


def test_a_minimal_opensim_model_is_the_wrapped_knee_again(tmp_path: Path) -> None:
    knee = wrapped_knee()
    found = import_opensim(write_opensim(knee, tmp_path))
    lines, wanted = lines_in_bones(found), lines_in_bones(knee)
    for name in ("obstacle_radius", "obstacle_is_tibial", "reference_length"):
        np.testing.assert_allclose(getattr(lines, name), getattr(wanted, name), atol=1e-7)
    for name in ("obstacle_centre", "obstacle_axis"):
        np.testing.assert_allclose(getattr(lines, name), getattr(wanted, name), atol=1e-6)
    strains, as_given = ([y.reference_strain_pct for y in x.ligaments] for x in (found, knee))
    np.testing.assert_allclose(strains, as_given, atol=1e-6)


def test_slack_lengths_of_a_published_model_mean_its_wrapped_paths() -> None:
    """Lenhart's strains are whole numbers (of most, half ones) only along the wrapped paths."""
    found = imported_knee("lenhart2015")
    strains = {x.name: x.reference_strain_pct for x in found.knee.ligaments if x.wrap is not None}
    assert len(strains) == 23
    stated = [x for name, x in strains.items() if name.startswith(("pCAP", "MCLs", "MCLd"))]
    np.testing.assert_allclose(stated, np.round(stated), atol=0.02)
    (fitted,) = (x for x in found.not_taken if "ellipsoid" in x.why)
    assert len(fitted.names) == 15
    assert re.findall(r"[\d.]+(?= mm)", fitted.why) == ["0.12"]
    straight = import_opensim("lenhart2015", wrapping=False)
    for one, other in zip(found.knee.ligaments, straight.ligaments, strict=True):
        assert other.wrap is None
        assert other.reference_strain_pct == pytest.approx(straightened(one).reference_strain_pct)


def test_around_an_ellipsoid_that_is_a_sphere() -> None:
    """Tangents and an arc in closed form; the circle is the sphere's."""
    start, end, radius = np.array([12.0, 1.0, 2.0]), np.array([-11.0, 3.0, -1.0]), 6.0
    found = shortest_way(start, end, np.full(3, radius))
    apart = [np.linalg.norm(x) for x in (start, end)]
    angle = np.arccos(start @ end / np.prod(apart))
    arc = angle - sum(np.arccos(radius / x) for x in apart)
    wanted = sum(np.sqrt(x**2 - radius**2) for x in apart) + radius * arc
    assert found.length == pytest.approx(wanted, abs=1e-3)
    assert found.radius == pytest.approx(radius, abs=1e-3)
    np.testing.assert_allclose(found.centre, 0.0, atol=1e-3)


def test_a_left_knee_wraps_as_its_mirror_image(tmp_path: Path) -> None:
    protocol = small_protocol()
    found = []
    sides: tuple[Side, ...] = ("right", "left")
    for side in sides:
        made = replace(wrapped_knee(), side=side)
        knee = read_subject(write_subject(made, tmp_path / side))
        model = LaxityModel(knee=knee, protocol=protocol)
        found.append(model.predict(model.parameters.start, derivatives=False).coordinates)
    np.testing.assert_allclose(found[0], found[1], atol=1e-5)


def test_an_obstacle_that_is_not_touched_changes_nothing() -> None:
    far = {"MCL": Obstacle(bone="tibia", centre=np.array([0.0, -30.0, 40.0]), radius_mm=3.0)}
    protocol, found = small_protocol(), []
    for knee in (ik.reference_knee(), wrapped_knee(far), wrapped_knee()):
        model = LaxityModel(knee=knee, protocol=protocol)
        found.append(model.predict(model.parameters.start, derivatives=False).coordinates)
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)
    assert np.nanmax(np.abs(found[2] - found[0])) > 0.1


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"radius_mm": 0.0}, "radius"),
        ({"radius_mm": float("inf")}, "radius"),
        ({"axis": np.zeros(3)}, "axis"),
        ({"centre": np.array([0.0, np.nan, 0.0])}, "centre"),
        ({"bone": "patella"}, "patella"),
        ({"side": np.array([0.0, 0.0, 1.0]), "axis": None}, "sphere"),
        ({"centre": np.array([1e7, 0.0, 0.0])}, "centre"),
    ],
)
def test_what_is_no_obstacle_is_refused(wrong: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        replace(OBSTACLES["LCL"], **wrong)


def test_a_ligament_passes_its_obstacle_on_one_side() -> None:
    """A line through the axis has no nearer side; stating one decides."""
    mcl = ik.reference_knee().ligament("MCL")
    middle = 0.5 * (mcl.femur + mcl.tibia)
    through = Obstacle(bone="tibia", centre=middle, radius_mm=4.0, axis=np.array([1.0, 0.0, 0.0]))
    with pytest.raises(ValueRefused, match="axis") as caught:
        replace(mcl, wrap=through)
    assert "side" in caught.value.remedy
    pushed = [
        replace(mcl, wrap=replace(through, side=np.array([0.0, 0.0, z]))).length for z in (1, -1)
    ]
    # As far around on either side, and longer than straight.
    assert pushed[0] == pytest.approx(pushed[1], abs=0.05)
    assert pushed[0] > mcl.length + 0.2


def test_a_file_says_which_ligament_has_a_wrong_obstacle(tmp_path: Path) -> None:
    folder = write_subject(wrapped_knee(), tmp_path / "subject")
    file = folder / "subject.toml"
    text = file.read_text("utf-8")
    for before, after, named in (
        ("radius_mm = 12.0", "radius_mm = -12.0", "ligament MCL, wrap"),
        ('bone = "tibia"', 'bone = "shank"', "bone"),
        ("radius_mm = 12.0", "radius_m = 0.012", "radius_m"),
    ):
        file.write_text(text.replace(before, after), "utf-8")
        with pytest.raises(InputError, match=named):
            read_subject(folder)


def test_an_insertion_inside_its_obstacle_is_found() -> None:
    knee = wrapped_knee()
    mcl = knee.ligament("MCL")
    inside = replace(OBSTACLES["MCL"], centre=mcl.tibia + np.array([0.0, 3.0, 2.0]))
    made = [replace(x, wrap=inside) if x.name == "MCL" else x for x in knee.ligaments]
    codes = {x.code: x for x in check_geometry(knee.with_ligaments(made))}
    assert codes["insertion-inside-obstacle"].values["depth_mm"] > 5.0
    assert "insertion-inside-obstacle" not in {x.code for x in check_geometry(knee)}


def test_mesh_contact_and_blind_cases_are_of_straight_ligaments() -> None:
    with pytest.raises(ValueError, match=r"PCL, LCL, MCL"):
        LaxityModel(knee=wrapped_knee(), protocol=small_protocol(), contact="mesh")
    with pytest.raises(ValueError, match="straight ligaments"):
        experiment_of(wrapped_knee(), small_protocol())
