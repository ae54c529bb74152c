"""What an import leaves out or changes is listed, and a model that would be misread is refused."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mesh_defects import write_polygons
from osim_files import LIGAMENT, write_model

from identknee.runs.errors import InputError
from identknee.subject.knee import Knee
from identknee.subject.opensim import NotTaken, import_opensim, imported_knee, left_out_of
from identknee.subject.reference import reference_knee
from identknee.subject.surface import Surface, joined, read_surface, write_surface


@pytest.fixture(scope="module")
def knee() -> Knee:
    return reference_knee(3.0, femur_edge_mm=2.0)


def edited(path: Path, *edits: tuple[str, str]) -> Path:
    text = path.read_text(encoding="utf-8")
    for before, after in edits:
        assert before in text
        text = text.replace(before, after)
    path.write_text(text, encoding="utf-8")
    return path


def listed(path: Path, **words: str) -> dict[tuple[str, str], NotTaken]:
    """What was left out or changed, by its names and class."""
    found = left_out_of(imported_knee(path, **words))  # type: ignore[arg-type]
    return {(name, x.kind): x for x in found for name in x.names}


def refused(path: Path, **words: str) -> InputError:
    """How the import of a model is refused."""
    with pytest.raises(InputError) as caught:
        import_opensim(path, **words)  # type: ignore[arg-type]
    assert caught.value.path == str(path)
    return caught.value


def changed(path: Path, name: str, change: Callable[[str], str]) -> Path:
    """The model with one of its ligaments written otherwise."""
    text = path.read_text(encoding="utf-8")
    own = re.search(
        rf'<Blankevoort1991Ligament name="{name}">.*?</Blankevoort1991Ligament>', text, re.S
    )
    assert own is not None
    assert change(own[0]) != own[0]
    path.write_text(text.replace(own[0], change(own[0])), encoding="utf-8")
    return path


KIND = "Blankevoort1991Ligament"


@pytest.mark.parametrize("word", ["false", " False\n", "0"])
@pytest.mark.parametrize("bundles", ["separate", "merged"])
def test_a_ligament_that_applies_no_force_is_left_out(
    tmp_path: Path, knee: Knee, word: str, bundles: str
) -> None:
    path = changed(
        write_model(tmp_path, knee),
        "ACL",
        lambda x: x.replace("<linear_st", f"<appliesForce>{word}</appliesForce><linear_st"),
    )
    found = imported_knee(path, bundles=bundles)  # type: ignore[arg-type]
    assert [x.name for x in found.knee.ligaments] == ["PCL", "LCL", "MCL"]
    (refusal,) = [x for x in left_out_of(found) if "ACL" in x.names]
    assert (refusal.kind, refusal.change, refusal.is_line) == (KIND, "left out", True)
    assert "ACL" in found.knee.description


@pytest.mark.parametrize("word", ["true", "True ", "1"])
def test_a_ligament_disabled_as_before_opensim_4_is_left_out(
    tmp_path: Path, knee: Knee, word: str
) -> None:
    path = changed(
        write_model(tmp_path, knee),
        "ACL",
        lambda x: x.replace("<linear_st", f"<isDisabled>{word}</isDisabled><linear_st"),
    )
    assert [x.name for x in imported_knee(path).knee.ligaments] == ["PCL", "LCL", "MCL"]


def test_what_a_ligament_leaves_to_the_default_of_its_class(tmp_path: Path, knee: Knee) -> None:
    off = f"<{KIND}><appliesForce>false</appliesForce></{KIND}>"
    path = edited(
        changed(
            write_model(tmp_path, knee),
            "ACL",
            lambda x: x.replace("<linear_st", "<appliesForce>true</appliesForce><linear_st"),
        ),
        ("<length_units>", f"<defaults>{off}</defaults><length_units>"),
    )
    found = imported_knee(path)
    assert [x.name for x in found.knee.ligaments] == ["ACL"]
    assert {y for x in left_out_of(found) if x.kind == KIND for y in x.names} == {
        *("PCL", "LCL", "MCL")
    }


def test_a_model_without_a_force_that_is_on(tmp_path: Path, knee: Knee) -> None:
    off = "<appliesForce>false</appliesForce><linear_stiffness>"
    path = edited(write_model(tmp_path, knee), ("<linear_stiffness>", off))
    with pytest.raises(InputError, match="Switch on those"):
        import_opensim(path)


def test_one_that_applies_its_force_is_no_remark(tmp_path: Path, knee: Knee) -> None:
    path = changed(
        write_model(tmp_path, knee),
        "ACL",
        lambda x: x.replace("<linear_st", "<appliesForce>true</appliesForce><linear_st"),
    )
    assert not left_out_of(imported_knee(path))


@pytest.mark.parametrize("kind", ["Ligament", "MyLigament", "PathSpring", "Smith2018Ligament"])
@pytest.mark.parametrize("bundles", ["separate", "merged"])
def test_ligaments_of_other_classes_are_named(
    tmp_path: Path, knee: Knee, kind: str, bundles: str
) -> None:
    path = changed(write_model(tmp_path, knee), "LCL", lambda x: x.replace(KIND, kind))
    refusal = listed(path, bundles=bundles)["LCL", kind]
    assert (refusal.change, refusal.is_line) == ("left out", True)
    assert "LCL" not in [x.name for x in import_opensim(path).ligaments]


@pytest.mark.parametrize("place", [
    "<ComponentSet><objects>{}</objects></ComponentSet>",
    "<BodySet><objects><Body name='femur_r'><components>{}</components></Body></objects></BodySet>",
    "<ForceSet><objects><ForceSet name='it'><objects>{}</objects></ForceSet></objects></ForceSet>",
])  # fmt: skip
@pytest.mark.parametrize("bundles", ["separate", "merged"])
def test_a_ligament_of_another_class_is_named_wherever_it_stands(
    tmp_path: Path, knee: Knee, place: str, bundles: str
) -> None:
    path = write_model(tmp_path, knee)
    text = path.read_text(encoding="utf-8")
    line = re.search(rf'<{KIND} name="LCL">.*?</{KIND}>', text, re.S)
    assert line is not None
    there = place.format(line[0].replace(KIND, "Ligament"))
    edited(changed(path, "LCL", lambda _: ""), ("<length_units>", f"{there}<length_units>"))
    assert listed(path, bundles=bundles)["LCL", "Ligament"].is_line
    assert ("it", "ForceSet") not in listed(path)


def test_a_ligament_without_a_name_is_said_to_be_left_out(tmp_path: Path, knee: Knee) -> None:
    path = changed(write_model(tmp_path, knee), "LCL", lambda x: x.replace(' name="LCL"', ""))
    assert listed(path)["without a name", KIND].is_line


@pytest.mark.parametrize("bundles", ["separate", "merged"])
def test_two_ligaments_of_one_name_are_refused(tmp_path: Path, knee: Knee, bundles: str) -> None:
    path = changed(write_model(tmp_path, knee), "LCL", lambda x: 2 * x)
    with pytest.raises(InputError, match=r"ligament LCL: another ligament .* has this name"):
        imported_knee(path, bundles=bundles)  # type: ignore[arg-type]


def test_contact_of_other_geometry_on_a_bone_of_the_knee_is_said(
    tmp_path: Path, knee: Knee
) -> None:
    kind = "SmoothSphereHalfSpaceForce"
    force = f'<{kind} name="it"><socket_sphere>/contactgeometryset/ball</socket_sphere></{kind}>'
    ball = (
        '<ContactSphere name="ball"><socket_frame>/bodyset/femur_r</socket_frame></ContactSphere>'
    )
    path = edited(
        write_model(tmp_path, knee),
        _force(force),
        ("<ContactGeometrySet><objects>", f"<ContactGeometrySet><objects>{ball}"),
    )
    assert listed(path)["it", kind].why.startswith("it acts on a bone of this knee")


def test_deep_bundles_do_not_stand_for_superficial_ones(tmp_path: Path, knee: Knee) -> None:
    path = write_model(tmp_path, knee)
    changed(path, "MCL", lambda x: x.replace('"MCL"', '"MCLd1"') + x.replace('"MCL"', '"MCLs1"'))
    changed(path, "MCLs1", lambda x: x.replace(KIND, "Ligament"))
    found = imported_knee(path, bundles="merged")
    assert [x.name for x in found.knee.ligaments] == ["ACL", "PCL", "LCL"]
    names = {(y, x.kind) for x in left_out_of(found) for y in x.names}
    assert {("MCLd1", KIND), ("MCLs1", "Ligament")} <= names


def _force(text: str) -> tuple[str, str]:
    return "<ForceSet><objects>", f"<ForceSet><objects>{text}"


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        ("CoordinateLimitForce", "<coordinate>knee_angle_r</coordinate>"),
        ("SpringGeneralizedForce", "<coordinate>hip_r</coordinate>"),
        ("BushingForce", "<socket_frame1>/bodyset/femur_r</socket_frame1>"),
        ("MyOwnForce", ""),
        ("Millard2012EquilibriumMuscle", "<max_isometric_force>9</max_isometric_force>"),
        ("Smith2018ArticularContactForce", ""),
    ],
)
def test_every_other_force_is_named(tmp_path: Path, knee: Knee, kind: str, content: str) -> None:
    path = edited(write_model(tmp_path, knee), _force(f'<{kind} name="it">{content}</{kind}>'))
    assert (("it", kind)) in listed(path)
    assert len(import_opensim(path).ligaments) == 4


POINTS = (
    (
        "PointToPointSpring",
        "<socket_body1>/bodyset/{}</socket_body1><socket_body2>../{}</socket_body2>",
    ),
    ("ExpressionBasedPointToPointForce", "<body1>{}</body1><body2>{}</body2>"),
)


@pytest.mark.parametrize(("kind", "content"), POINTS)
@pytest.mark.parametrize("bundles", ["separate", "merged"])
@pytest.mark.parametrize("group", ["ForceSet", "components"])
def test_a_line_between_points_is_a_ligament_that_is_left_out(
    tmp_path: Path, knee: Knee, kind: str, content: str, bundles: str, group: str
) -> None:
    path = changed(write_model(tmp_path, knee), "PCL", lambda _: "")
    line = f'<{kind} name="PCL_spring">{content.format("tibia_r", "femur_r")}</{kind}>'
    if group == "components":
        edited(path, ("<length_units>", f"<components>{line}</components><length_units>"))
    else:
        edited(path, _force(line))
    refusal = listed(path, bundles=bundles)["PCL_spring", kind]
    assert (refusal.change, refusal.is_line) == ("left out", True)
    assert [x.name for x in import_opensim(path).ligaments] == ["ACL", "LCL", "MCL"]


def test_a_line_between_points_of_other_bodies_is_no_ligament(tmp_path: Path, knee: Knee) -> None:
    kind, content = POINTS[1]
    one = f'<{kind} name="it">{content.format("talus_r", "pelvis")}</{kind}>'
    path = edited(write_model(tmp_path, knee), _force(one))
    refusal = listed(path)["it", kind]
    assert not refusal.is_line
    assert "bone" in refusal.why


def test_contact_that_is_switched_off_is_said(tmp_path: Path, knee: Knee) -> None:
    kind = "Smith2018ArticularContactForce"
    words = {}
    for off in ("false", "true"):
        folder = tmp_path / off
        folder.mkdir()
        force = f'<{kind} name="it"><appliesForce>{off}</appliesForce></{kind}>'
        words[off] = listed(edited(write_model(folder, knee), _force(force)))["it", kind].why
    assert "switched off" in words["false"]
    assert "switched" not in words["true"]
    assert "identknee" in words["true"]


def test_a_path_may_stand_in_another_element(tmp_path: Path, knee: Knee) -> None:
    path = changed(
        write_model(tmp_path, knee),
        "ACL",
        lambda x: x.replace("<GeometryPath", "<path><GeometryPath").replace(
            "</GeometryPath>", "</GeometryPath></path>"
        ),
    )
    assert [x.name for x in import_opensim(path).ligaments] == ["ACL", "PCL", "LCL", "MCL"]


@pytest.mark.parametrize("bundles", ["separate", "merged"])
def test_a_ligament_whose_path_is_a_function_is_left_out(
    tmp_path: Path, knee: Knee, bundles: str
) -> None:
    path = changed(
        write_model(tmp_path, knee),
        "ACL",
        lambda x: re.sub("<GeometryPath.*</GeometryPath>", "<FunctionBasedPath/>", x, flags=re.S),
    )
    assert listed(path, bundles=bundles)["ACL", KIND].change == "left out"


def test_a_model_of_another_class_alone_is_refused_by_its_name(tmp_path: Path, knee: Knee) -> None:
    path = edited(write_model(tmp_path, knee), (KIND, "Ligament"))
    refusal = refused(path)
    assert refusal.where == "forces"
    assert "class Ligament," in refusal.why


def test_other_units_than_those_of_opensim_are_named(tmp_path: Path, knee: Knee) -> None:
    def model(name: str, before: str, after: Callable[[float], str]) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        path = write_model(folder, knee)
        text = path.read_text(encoding="utf-8")
        new = re.sub(rf"(?<=<{before}>)[^<]+", lambda x: after(float(x[0])), text)
        assert new != text
        path.write_text(new, encoding="utf-8")
        return path

    slack = refused(model("slack", "slack_length", lambda x: f"{1000 * x}"))
    assert slack.where == "ligament ACL"
    assert "slack length" in slack.why
    assert "metres" in slack.remedy
    stiffness = refused(model("kN", "linear_stiffness", lambda x: f"{x / 1000}"))
    assert stiffness.why.endswith(" linear_stiffness of 42.3 N")
    assert "kN" in stiffness.remedy
    assert "1000" in stiffness.remedy
    path = write_model(tmp_path, knee)
    edited(path, (">1 1 1</scale_factors>", ">1e3 1e3 1e3</scale_factors>"))
    mesh = refused(path)
    assert mesh.where.endswith(" femur_mesh")
    assert "0.001" in mesh.remedy


def test_a_number_that_is_missing_is_said_to_be(tmp_path: Path, knee: Knee) -> None:
    path = changed(
        write_model(tmp_path, knee),
        "ACL",
        lambda x: re.sub("<slack_length>.*</slack_length>", "", x),
    )
    refusal = refused(path)
    assert refusal.where == f"{KIND} ACL"
    assert refusal.why.startswith("<slack_length> ")
    assert "missing" in refusal.why


def test_ligaments_elsewhere_are_named(tmp_path: Path, knee: Knee) -> None:
    patellar = LIGAMENT.format(
        name="PT", side="r", femur="0 0 0", tibia="0 0 1", stiffness=1, slack=1, via=""
    ).replace("femur_r", "patella_r")
    refusal = listed(edited(write_model(tmp_path, knee), _force(patellar)))["PT", KIND]
    assert (refusal.change, refusal.is_line) == ("left out", False)


def _point(kind: str) -> Callable[[str], str]:
    return lambda x: x.replace('<PathPoint name="a">', f'<{kind} name="a">', 1).replace(
        "</PathPoint>", f"</{kind}>", 1
    )


def test_ends_that_move_or_hold_in_a_range(tmp_path: Path, knee: Knee) -> None:
    path = changed(write_model(tmp_path, knee), "ACL", _point("MovingPathPoint"))
    changed(path, "PCL", _point("ConditionalPathPoint"))
    changed(
        path,
        "LCL",
        lambda x: x.replace("<linear", "<transition_strain>0.03</transition_strain><linear"),
    )
    via = '<ConditionalPathPoint name="v"></ConditionalPathPoint><PathPoint name="b">'
    changed(path, "MCL", lambda x: x.replace('<PathPoint name="b">', via))
    refusal = listed(path)
    changes = {name: refusal[name, KIND].change for name in ("ACL", "PCL", "LCL", "MCL")}
    assert changes == {"ACL": "left out", "PCL": "changed", "LCL": "changed", "MCL": "changed"}
    assert [x.name for x in import_opensim(path).ligaments] == ["PCL", "LCL", "MCL"]


COORDINATE = """<coordinates><Coordinate name="knee_angle_r"><default_value>{}</default_value>
<locked>{}</locked></Coordinate></coordinates><SpatialTransform>"""


def test_defaults_that_are_not_zero_are_said(tmp_path: Path, knee: Knee) -> None:
    path = edited(
        write_model(tmp_path, knee), ("<SpatialTransform>", COORDINATE.format(0.5236, "true"))
    )
    found = left_out_of(imported_knee(path))
    assert [(x.kind, x.names, x.change) for x in found] == [
        ("Coordinate", ("knee_angle_r",), "changed")
    ] * 2
    edited(path, ("0.5236", "0"), ("<locked>true", "<locked>false"))
    assert not left_out_of(imported_knee(path))


TURN = """<TransformAxis name="rotation3"><coordinates>knee_angle_r</coordinates><axis>{}</axis>
{}</TransformAxis></SpatialTransform>"""
FLEXES = '<LinearFunction name="function"><coefficients>1 0</coefficients></LinearFunction>'


@pytest.mark.parametrize(("axis", "word"), [("1 0 0", "+x"), ("0 -1 0", "-y"), ("0.9 0 0.3", "+x")])
def test_a_flexion_axis_that_is_not_lateral_is_refused(
    tmp_path: Path, knee: Knee, axis: str, word: str
) -> None:
    path = write_model(tmp_path, knee)
    edited(path, ("</SpatialTransform>", TURN.format(axis, FLEXES)))
    why = refused(path).why
    assert "flexion" in why
    assert f" {word} " in why
    edited(path, (f"<axis>{axis}</axis>\n<Lin", "<axis>0 0 -1</axis>\n<Lin"))
    assert len(import_opensim(path).ligaments) == 4


def test_coupled_motion_of_the_joint_is_said(tmp_path: Path, knee: Knee) -> None:
    spline = '<SimmSpline name="function"><x>-1 0 1</x><y>0.1 0 0.1</y></SimmSpline>'
    path = edited(
        write_model(tmp_path, knee), ("</SpatialTransform>", TURN.format("0 0 1", spline))
    )
    assert listed(path)["rotation3", "TransformAxis"].change == "left out"


@pytest.mark.parametrize(
    ("turn", "words"),
    [
        (((0, 0, 1), (1, 0, 0), (0, 1, 0)), "up is +z"),
        (((0, -1, 0), (1, 0, 0), (0, 0, 1)), "up is -x"),
        (((0, 0, 1), (0, 1, 0), (-1, 0, 0)), "lateral, as MCL to LCL says, is +x"),
        (((1, 0, 0), (0, -1, 0), (0, 0, -1)), "up is -y"),
    ],
)
def test_other_axes_are_named(
    tmp_path: Path, knee: Knee, turn: tuple[tuple[int, ...], ...], words: str
) -> None:
    rotation = np.array(turn, float)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    path = write_model(tmp_path, knee)
    for name in ("femur", "tibia"):
        file = tmp_path / "Geometry" / f"{name}.stl"
        write_surface(read_surface(file).moved(rotation, np.zeros(3)), file)
    text = path.read_text(encoding="utf-8")

    def turned(found: re.Match[str]) -> str:
        place = rotation @ [float(x) for x in found[1].split()]
        return f"<location>{' '.join(map(repr, place.tolist()))}</location>"

    path.write_text(re.sub("<location>([^<]*)</location>", turned, text), encoding="utf-8")
    refusal = refused(path)
    assert words in refusal.why
    axes = re.findall("([xyz]) (?:to the )?(anterior|superior|right)", refusal.remedy)
    assert axes == [("x", "anterior"), ("y", "superior"), ("z", "right")]


AXIS_OR_SIDE = re.compile(r"[+-]z|right|left")


def test_collateral_ligaments_on_the_wrong_sides_are_refused(tmp_path: Path, knee: Knee) -> None:
    path = edited(
        write_model(tmp_path, knee), ('"MCL"', '"x"'), ('"LCL"', '"MCL"'), ('"x"', '"LCL"')
    )
    assert AXIS_OR_SIDE.findall(refused(path).why)[-3:] == ["-z", "+z", "right"]


def _both_legs(folder: Path, knee: Knee) -> Path:
    """A model of two legs, the left one the mirror of the right one."""
    (folder / "l").mkdir(parents=True)
    path = write_model(folder, knee)
    left = write_model(folder / "l", knee, side="l").read_text(encoding="utf-8")
    for name in ("femur", "tibia"):
        (folder / "l" / "Geometry" / f"{name}.stl").rename(folder / "Geometry" / f"{name}_l.stl")
    text = path.read_text(encoding="utf-8")
    for group in ("JointSet", "ForceSet", "ContactGeometrySet"):
        more = re.search(f"<{group}><objects>(.*?)</objects></{group}>", left, re.S)
        assert more is not None
        own = re.sub('name="([A-Z]CL)"', r'name="\1_l"', more[1])
        own = own.replace("femur.stl", "femur_l.stl").replace("tibia.stl", "tibia_l.stl")
        text = text.replace(f"</objects></{group}>", f"{own}</objects></{group}>")
    bodies = "".join(f'<Body name="{x}_{y}"/>' for x in ("femur", "tibia", "talus") for y in "rl")
    text = text.replace(
        "<JointSet>", f"<BodySet><objects>{bodies}</objects></BodySet><JointSet>", 1
    )
    path.write_text(text, encoding="utf-8")
    return path


def test_one_of_two_legs(tmp_path: Path, knee: Knee) -> None:
    path = _both_legs(tmp_path / "both", knee)
    assert re.findall(r"--side (\w+)", str(refused(path))) == ["left", "right"]
    right, left = (import_opensim(path, side=x) for x in ("right", "left"))
    assert (right.side, left.side) == ("right", "left")
    assert [x.name for x in left.ligaments] == ["ACL_l", "PCL_l", "LCL_l", "MCL_l"]
    for one, other in zip(right.ligaments, left.ligaments, strict=True):
        np.testing.assert_allclose(one.femur, other.femur, atol=1e-9)
    refusal = listed(path, side="left")
    assert {("femur_r", "Body"), ("talus_r", "Body"), ("talus_l", "Body"), ("ACL", KIND)} <= set(
        refusal
    )
    assert refusal["talus_r", "Body"].why != refusal["talus_l", "Body"].why
    one_leg = write_model(tmp_path, knee)
    told_of_one = refused(one_leg, side="left")
    assert told_of_one.where == "contact geometry"
    assert "left femur" in told_of_one.why


def test_a_side_that_no_name_tells_is_stated(tmp_path: Path, knee: Knee) -> None:
    path = edited(write_model(tmp_path, knee), ("_r<", "<"), ("knee_r", "knee"))
    assert "--side" in refused(path).remedy
    assert import_opensim(path, side="right").side == "right"
    assert AXIS_OR_SIDE.findall(refused(path, side="left").why)[-3:] == ["+z", "-z", "left"]


def _bridged(knee: Knee) -> Surface:
    """Both plateaus with a strip between them, so that they are one piece."""
    both = joined(*knee.tibia)
    rims = [x.boundary_edges.ravel() for x in knee.tibia]
    starts = [0, len(knee.tibia[0].vertices)]
    ends = [both.vertices[x + i] for x, i in zip(rims, starts, strict=True)]
    a = rims[0][int(np.argmax(ends[0][:, 2]))]
    edges = knee.tibia[0].boundary_edges
    edge = edges[(edges == a).any(axis=1)][0]
    b = rims[1][int(np.argmin(ends[1][:, 2]))] + starts[1]
    corner = both.vertices[[*edge, b]]
    up = np.cross(corner[1] - corner[0], corner[2] - corner[0])[1] > 0.0
    face = [edge[0], edge[1], b] if up else [edge[1], edge[0], b]
    return Surface(vertices=both.vertices, faces=np.concatenate([both.faces, [face]]))


def test_a_tibia_in_one_piece_is_cut_between_the_plateaus(tmp_path: Path, knee: Knee) -> None:
    path = write_model(tmp_path, knee)
    write_surface(_bridged(knee).scaled(1e-3), tmp_path / "Geometry" / "tibia.stl")
    found = imported_knee(path)
    for part, wanted in zip(found.knee.tibia, knee.tibia, strict=True):
        assert abs(len(part.faces) - len(wanted.faces)) <= 1
        assert part.areas.sum() == pytest.approx(wanted.areas.sum(), rel=0.05)
    (refusal,) = left_out_of(found)
    assert (refusal.change, refusal.names) == ("changed", ("tibia",))


def test_one_plateau_is_not_cut(tmp_path: Path, knee: Knee) -> None:
    path = write_model(tmp_path, knee)
    write_surface(knee.tibia[0].scaled(1e-3), tmp_path / "Geometry" / "tibia.stl")
    refusal = refused(path)
    assert refusal.where == "contact geometry"
    assert "one plateau" in refusal.why


@pytest.mark.parametrize("bone", ["femur", "tibia"])
def test_a_mesh_that_is_mirrored_by_its_scale(tmp_path: Path, knee: Knee, bone: str) -> None:
    path = write_model(tmp_path, knee)
    file = tmp_path / "Geometry" / f"{bone}.stl"
    write_surface(read_surface(file).mirrored(), file)
    factors = "</scale_factors></Smith2018ContactMesh>"
    mesh = f"<mesh_file>{bone}.stl</mesh_file><scale_factors>1 1 "
    edited(path, (f"{mesh}1{factors}", f"{mesh}-1{factors}"))
    found = imported_knee(path)
    assert [x.names for x in left_out_of(found)] == [(f"{bone}_mesh",)]
    np.testing.assert_allclose(found.knee.femur.centroid, knee.femur.centroid, atol=1e-4)


@pytest.mark.parametrize("bone", ["femur", "tibia"])
def test_meshes_in_vtp_files(tmp_path: Path, knee: Knee, bone: str) -> None:
    path = edited(write_model(tmp_path, knee), (f"{bone}.stl", f"{bone}.vtp"))
    surface = read_surface(tmp_path / "Geometry" / f"{bone}.stl")
    write_polygons(tmp_path / "Geometry" / f"{bone}.vtp", surface.vertices, surface.faces.tolist())
    found = import_opensim(path)
    assert len(found.femur.faces) == len(knee.femur.faces)


def test_crumbs_are_said(tmp_path: Path, knee: Knee) -> None:
    path = write_model(tmp_path, knee)
    crumb = Surface(vertices=np.eye(3) / 10.0, faces=np.array([[0, 1, 2]]))
    write_surface(joined(*knee.tibia, crumb).scaled(1e-3), tmp_path / "Geometry" / "tibia.stl")
    (refusal,) = left_out_of(imported_knee(path))
    assert (refusal.change, len(refusal.names)) == ("left out", 1)


def test_a_mesh_given_twice_counts_once(tmp_path: Path, knee: Knee) -> None:
    path = write_model(tmp_path, knee)
    text = path.read_text(encoding="utf-8")
    mesh = re.findall("<Smith2018ContactMesh.*?</Smith2018ContactMesh>", text, re.S)[1]
    again = mesh.replace("tibia_mesh", "again")
    path.write_text(text.replace(mesh, mesh + again), encoding="utf-8")
    assert listed(path)["again", "Smith2018ContactMesh"].change == "left out"
    assert len(import_opensim(path).tibia[0].faces) == len(knee.tibia[0].faces)
    edited(path, ("tibia.stl", "femur.stl"))
    refusal = refused(path)
    assert refusal.where.endswith(" tibia_mesh")
    assert "same" in refusal.why
    assert refusal.why.endswith(" femur.stl")


@pytest.mark.parametrize(
    ("written", "kept"),
    [
        ("Geometry\\femur.stl", "Geometry/femur.stl"),
        ("FEMUR.STL", "Geometry/femur.stl"),
        ("femur.stl", "geometry/Femur.stl"),
        ("C:\\Users\\me\\Geometry\\femur.stl", "Geometry/femur.stl"),
        ("meshes\\Femur.stl", "Meshes/femur.STL"),
        ("..\\Geometry\\FEMUR.stl", "Geometry/femur.stl"),
        ("femur.stl", "FEMUR.stl"),
    ],
)
def test_names_of_windows_and_in_another_case(
    tmp_path: Path, knee: Knee, written: str, kept: str
) -> None:
    path = edited(write_model(tmp_path, knee), (">femur.stl<", f">{written}<"))
    (tmp_path / "Geometry" / "femur.stl").rename(tmp_path / "moved")
    if kept.startswith("geometry"):
        (tmp_path / "Geometry").rename(tmp_path / "geometry")
    (tmp_path / kept).parent.mkdir(exist_ok=True)
    (tmp_path / "moved").rename(tmp_path / kept)
    assert len(import_opensim(path).femur.faces) == len(knee.femur.faces)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (b"Q & A", "the character &"),
        (b"Q&A", "the character &"),
        ("Größe & Gewicht".encode(), "the character &"),
        (b"p < 0.05", "the character <"),
        (b"a\x01b", r"U\+0001"),
        ("µµ\x01".encode(), r"U\+0001"),
        (b"M\xfcller", "the byte 0xFC"),
        ("\ufffe".encode(), r"U\+FFFE"),
    ],
)
def test_a_character_that_breaks_the_file_is_named(
    tmp_path: Path, knee: Knee, wrong: bytes, said: str
) -> None:
    path = write_model(tmp_path, knee)
    content = path.read_bytes()
    at = content.index(b"<length_units>")
    path.write_bytes(content[:at] + b"<credits>" + wrong + b"</credits>" + content[at:])
    with pytest.raises(InputError, match=said) as caught:
        import_opensim(path)
    line = content[:at].count(b"\n") + 1
    first = at - (content.rfind(b"\n", 0, at) + 1) + len("<credits>") + 1
    characters = wrong.decode("utf-8", "surrogateescape")
    offset = next(i for i, x in enumerate(characters) if x in "&<\x01\udcfc\ufffe")
    assert caught.value.where == f"line {line}, column {first + offset}"
    assert caught.value.remedy
