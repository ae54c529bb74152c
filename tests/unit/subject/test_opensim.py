import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from data_files import stored
from osim_files import LIGAMENT, write_model
from scipy.spatial import cKDTree

from identknee.runs.declare import Array
from identknee.runs.errors import InputError
from identknee.subject.folder import example, read_subject, write_subject
from identknee.subject.knee import Knee
from identknee.subject.opensim import (
    bundle_names,
    import_opensim,
    imported_knee,
    left_out_of,
    straightened,
)
from identknee.subject.reference import reference_knee

SINGLE = 1e-4  # mm; meshes have single precision
PLACE = 1e-9  # mm; roundings on the way through metres


@pytest.fixture(scope="module")
def knee() -> Knee:
    return reference_knee(3.0, femur_edge_mm=2.0)


def assert_same_knee(found: Knee, knee: Knee, offset: Array) -> None:
    """Equal but for the origin, which is `offset` [mm] from the knee's."""
    for line, same in zip(found.ligaments, knee.ligaments, strict=True):
        assert line.name == same.name
        np.testing.assert_allclose(line.femur, same.femur - offset, atol=PLACE)
        np.testing.assert_allclose(line.tibia, same.tibia - offset, atol=PLACE)
        assert line.stiffness_kN == pytest.approx(same.stiffness_kN, rel=1e-12)
        assert line.reference_strain_pct == pytest.approx(same.reference_strain_pct, abs=1e-9)
    for surface, as_before in zip(
        (found.femur, *found.tibia), (knee.femur, *knee.tibia), strict=True
    ):
        assert len(surface.vertices) == len(as_before.vertices)
        distance = cKDTree(surface.vertices).query(as_before.vertices - offset)[0]
        assert distance.max() < SINGLE
        assert surface.areas.sum() == pytest.approx(as_before.areas.sum(), rel=1e-5)


@pytest.mark.parametrize("side", ["r", "l"])
def test_joint_frames_and_sides(tmp_path: Path, knee: Knee, side: str) -> None:
    shift, offset = np.array([0.002, -0.003, 0.001]), np.array([0.01, 0.005, 0.0])
    path = write_model(tmp_path, knee, side=side, turn=0.1, shift=shift, offset=offset)
    found = import_opensim(path)
    assert found.side == {"r": "right", "l": "left"}[side]
    assert_same_knee(found, knee, 1000.0 * offset)
    # Mirrored, varus and z change their signs.
    sign = -1.0 if side == "l" else 1.0
    np.testing.assert_allclose(found.tibia_frame.origin, 1000.0 * shift * [1, 1, sign], atol=PLACE)
    cos, sin = np.cos(0.1), sign * np.sin(0.1)
    np.testing.assert_allclose(
        found.tibia_frame.axes.T, [[1, 0, 0], [0, cos, -sin], [0, sin, cos]], atol=1e-12
    )
    np.testing.assert_array_equal(found.femur_frame.axes, np.eye(3))


def test_what_is_imported_can_be_written_and_read(tmp_path: Path, knee: Knee) -> None:
    found = import_opensim(write_model(tmp_path, knee, side="l"))
    back = read_subject(write_subject(found, tmp_path / "subject"))
    np.testing.assert_array_equal(back.femur.vertices, found.femur.vertices)
    assert back.description == found.description


def test_via_points_are_told(tmp_path: Path, knee: Knee) -> None:
    via = (
        '<PathPoint name="v"><socket_parent_frame>/bodyset/femur_r</socket_parent_frame>'
        "<location>0 0 0</location></PathPoint>"
    )
    found = import_opensim(write_model(tmp_path, knee, via=via))
    assert re.findall(r"\b[A-Z]CL\b", found.description) == ["ACL", "PCL", "LCL", "MCL"]
    assert_same_knee(found, knee, np.zeros(3))


def _second_femur(text: str) -> str:
    mesh = text[text.index("<Smith2018ContactMesh") : text.index("</Smith2018ContactMesh>")]
    return text.replace(
        "<ContactGeometrySet><objects>",
        "<ContactGeometrySet><objects>"
        + mesh.replace("femur_r", "femur_l").replace("femur_mesh", "other")
        + "</Smith2018ContactMesh>",
    )


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda x: x.replace("</Model>", ""), "not valid XML"),
        (lambda x: x.replace("OpenSimDocument", "Document"), "this is not an OpenSim model"),
        (lambda x: x.replace('"40000"', '"30000"'), "not of OpenSim 4"),
        (lambda x: x.replace(">m<", ">mm<"), "lengths are in mm"),
        (lambda x: x.replace("/bodyset/femur_r</socket_frame>", "/bodyset/hip</socket_frame>"),
         "one femur with a contact mesh is wanted, found none"),
        (_second_femur, "found femur_l, femur_r"),
        (lambda x: x.replace("child_frame>/bodyset/tibia_r<", "child_frame>/bodyset/t<"),
         "no joint leads from femur_r to tibia_r"),
        (lambda x: x.replace("CustomJoint", "EllipsoidJoint"), "class EllipsoidJoint"),
        (lambda x: x.replace("TransformAxis", "Axis"), "this CustomJoint has no SpatialTransform"),
        (lambda x: x.replace("LinearFunction", "Sine"), "Sine cannot be evaluated at zero"),
        (lambda x: x.replace("femur.stl", "lost.stl"), "neither beside the model nor in Geometry"),
        (lambda x: x.replace("0 0</location><orient", "0 1</location><orient"),
         "its location is not zero"),
        (lambda x: x.replace("Blankevoort1991Ligament", "Ligament"), "no Blankevoort1991Ligament"),
        (lambda x: x.replace("<slack_length>", "<slack_length>-"), "slack length"),
        (lambda x: x.replace("<linear_stiffness>", "<linear_stiffness>-"), "stiffness of ACL"),
        (lambda x: x.replace("<linear_stiffness>", "<linear_stiffness>much"), "must hold numbers"),
        (lambda x: x.replace("<slack_length>", "<slack_length>1 "), "must hold one number"),
        (lambda x: x.replace("1 1 1</scale", "1 1</scale"), "must hold three numbers"),
        (lambda x: x.replace("_r<", "<").replace("knee_r", "knee"), "which side"),
        (lambda x: x.replace("1 1 1</scale", "0.001 0.001 0.001</scale"), "multiply by 1000"),
        (lambda x: x.replace("1 1 1</scale", "1 1e300 1</scale"), "must hold numbers up to 1e+09"),
        (lambda x: x.replace("<linear_stiffness>", "<linear_stiffness>9999"), "divide by 1000"),
        (lambda x: x.replace("<axis>1 0 0<", "<axis>0 0 0<"), "must hold a direction"),
        (lambda x: x.replace("<LinearFunction name=\"function\">", "<MultiplierFunction name="
         "\"function\"><scale>1</scale>" + "<function><MultiplierFunction><scale>1</scale>" * 500
         + "</MultiplierFunction></function>" * 500 + "</MultiplierFunction><LinearFunction>", 1),
         "MultiplierFunction cannot be evaluated at zero"),
        (lambda x: x.replace("<socket_parent>/bodyset/femur_r<", "<socket_parent>femur_offset<"),
         "or in a circle"),
    ],
)  # fmt: skip
def test_unusable_models(tmp_path: Path, knee: Knee, edit: Callable[[str], str], said: str) -> None:
    path = write_model(tmp_path, knee)
    before = path.read_text()
    path.write_text(edit(before))
    assert path.read_text() != before
    with pytest.raises(InputError) as caught:
        import_opensim(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("tag", "value", "where"),
    [
        ("slack_length", "0,03162", "Blankevoort1991Ligament ACL"),
        ("linear_stiffness", "6000,0", "Blankevoort1991Ligament ACL"),
        ("damping_coefficient", "0,003", "Blankevoort1991Ligament ACL"),
        ("scale_factors", "1,0 1,0 1,0", "Smith2018ContactMesh femur_mesh"),
        ("default_value", "0,5", "Coordinate angle"),
    ],
)
def test_a_decimal_comma_is_refused_with_element_and_value(
    tmp_path: Path, knee: Knee, tag: str, value: str, where: str
) -> None:
    path = write_model(tmp_path, knee)
    text = path.read_text()
    own = f"<{tag}>{value}</{tag}>"
    if tag == "default_value":
        angle = f'<coordinates><Coordinate name="angle">{own}</Coordinate></coordinates>'
        changed = text.replace("<SpatialTransform>", f"{angle}<SpatialTransform>", 1)
    elif f"<{tag}>" in text:
        changed = re.sub(rf"<{tag}>[^<]*</{tag}>", own, text, count=1)
    else:
        changed = text.replace("<linear_stiffness>", f"{own}<linear_stiffness>", 1)
    assert changed != text
    path.write_text(changed)
    with pytest.raises(InputError) as caught:
        left_out_of(imported_knee(path))
    assert caught.value.where == where
    assert f"<{tag}>" in caught.value.why
    assert f"'{value}'" in caught.value.why
    assert "decimal points" in caught.value.remedy


def test_merging_needs_all_four(tmp_path: Path, knee: Knee) -> None:
    path = write_model(tmp_path, knee.with_ligaments(knee.ligaments[:3]))
    with pytest.raises(InputError, match=r"MCLs.*sMCL.*MCL"):
        import_opensim(path, bundles="merged")
    with pytest.raises(ValueError, match=r'"separate".*"merged"'):
        import_opensim(path, bundles="all")  # type: ignore[arg-type]


def test_ligaments_of_other_bones_stay_out(tmp_path: Path, knee: Knee) -> None:
    path = write_model(tmp_path, knee)
    patellar = LIGAMENT.format(
        name="PT", side="r", femur="0 0 0", tibia="0 0 1", stiffness=1, slack=1, via=""
    ).replace("femur_r", "patella_r")
    path.write_text(
        path.read_text().replace("<ForceSet><objects>", f"<ForceSet><objects>{patellar}")
    )
    assert [x.name for x in import_opensim(path).ligaments] == ["ACL", "PCL", "LCL", "MCL"]


def test_the_55_bundles_of_lenhart2015() -> None:
    knee = import_opensim("lenhart2015")
    listed = stored("lenhart2015.json")
    assert knee.side == "right"
    assert len(knee.ligaments) == 55
    bundles = {x["name"]: x for x in listed["bundles"]}
    assert {x.name for x in knee.ligaments} == set(bundles)
    for line in knee.ligaments:
        bundle = bundles[line.name]
        # The list has four decimals, some of five significant digits.
        np.testing.assert_allclose(line.femur, bundle["femur_mm"], atol=6e-4)
        np.testing.assert_allclose(line.tibia, bundle["tibia_mm"], atol=6e-4)
        assert line.stiffness_kN == pytest.approx(bundle["linear_stiffness_N_per_strain"] / 1000)
        strain = 100.0 * bundle["straight_line_ref_strain"]
        straight = straightened(line)
        assert straight.reference_strain_pct == pytest.approx(strain, abs=6e-3)
        assert line.reference_strain_pct >= straight.reference_strain_pct
        # One bundle ends inside the ellipsoid that it should wrap around.
        may_wrap = bundle["wrap_object"] is not None and line.name != "MCLp1"
        assert (line.wrap is not None) == may_wrap
    assert [x.name for x in knee.groups] == [
        "MCLd",
        "MCLs",
        "ACLpl",
        "ACLam",
        "PCLal",
        "PCLpm",
        "LCL",
        "MCLp",
        "PFL",
        "pCAP",
    ]
    assert sum(len(x.members) for x in knee.groups) == 55
    places = {x.name: x.position for x in knee.landmarks}
    frames = listed["frames"]["landmarks_mm"]
    np.testing.assert_allclose(places["hip_centre"], frames["hip_centre_in_femur_frame"], atol=1e-3)
    np.testing.assert_allclose(
        places["ankle_centre"], frames["ankle_centre_in_tibia_frame"], atol=1e-3
    )


def test_the_four_lines_of_lenhart2015() -> None:
    knee = import_opensim("lenhart2015", bundles="merged")
    assert not knee.groups
    listed = stored("lenhart2015.json")["four_ligaments"]
    subject = example("lenhart2015")
    assert {x.name for x in knee.ligaments} == set(listed)
    for line in knee.ligaments:
        known = subject.ligament(line.name)
        np.testing.assert_allclose(line.femur, known.femur, atol=6e-5)
        np.testing.assert_allclose(line.tibia, known.tibia, atol=6e-5)
        entry = listed[line.name]
        assert line.stiffness_kN == pytest.approx(entry["sum_bundle_stiffness_N_per_strain"] / 1000)
        strain = 100.0 * entry["stiffness_weighted_mean_ref_strain"]
        assert line.reference_strain_pct == pytest.approx(strain, abs=1e-3)
    for found, known_surface in zip(
        (knee.femur, *knee.tibia), (subject.femur, *subject.tibia), strict=True
    ):
        assert len(found.faces) == len(known_surface.faces)
        distance = cKDTree(found.vertices).query(known_surface.vertices)[0]
        assert distance.max() < SINGLE


def test_a_bundle_may_be_named_before_its_ligament() -> None:
    knee = import_opensim("lenhart2015")
    other = {"ACLam": "aACL", "ACLpl": "pACL", "MCLs": "sMCL", "MCLd": "dMCL"}
    renamed = []
    for x in knee.ligaments:
        begins = next((y for y in other if x.name.startswith(y)), "")
        renamed.append(replace(x, name=other[begins] + x.name[len(begins) :]) if begins else x)
    for name in ("ACL", "PCL", "LCL", "MCL"):
        expected = [x.stiffness_kN for x in bundle_names(name, knee.ligaments)]
        assert len(expected) > 1
        assert [x.stiffness_kN for x in bundle_names(name, renamed)] == expected
