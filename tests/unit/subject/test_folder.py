import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from posed_knees import FIFTH, NAMES, posed_folder, posed_reference

from identknee.runs.errors import InputError
from identknee.subject.folder import read_subject, write_subject
from identknee.subject.knee import Knee, Landmark, Side
from identknee.subject.reference import reference_knee
from identknee.subject.surface import Surface, read_surface, write_surface
from identknee.verbs.verb import knee_digest

PLACE = 1e-9  # mm; roundings of coordinates of several hundred mm
AXES = """[frames.femur]
origin = [0.0, 0.0, 0.0]
axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]

[frames.tibia]
origin = [0.0, 0.0, 0.0]
axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
"""
LANDMARKS = """[landmarks]
hip_centre = [0.0, 400.0, 0.0]
ankle_centre = [0.0, -400.0, 0.0]
medial_epicondyle = [0.0, 0.0, -40.0]
lateral_epicondyle = [0.0, 0.0, 40.0]
"""


def assert_equal(one: Knee, other: Knee) -> None:
    assert (one.name, one.side, one.description) == (other.name, other.side, other.description)
    for a, b in zip((one.femur, *one.tibia), (other.femur, *other.tibia), strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.faces, b.faces)
    for line, same in zip(one.ligaments, other.ligaments, strict=True):
        assert line.name == same.name
        assert line.stiffness_kN == same.stiffness_kN
        assert line.reference_strain_pct == same.reference_strain_pct
        np.testing.assert_array_equal(line.femur, same.femur)
        np.testing.assert_array_equal(line.tibia, same.tibia)
    for frame, again in (
        (one.femur_frame, other.femur_frame),
        (one.tibia_frame, other.tibia_frame),
    ):
        np.testing.assert_array_equal(frame.origin, again.origin)
        np.testing.assert_array_equal(frame.axes, again.axes)
    for place, mark in zip(one.landmarks, other.landmarks, strict=True):
        assert place.name == mark.name
        np.testing.assert_array_equal(place.position, mark.position)


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coarse reference knee as a subject folder, its frames those of the scanner."""
    folder = tmp_path_factory.mktemp("example")
    return write_subject(replace(reference_knee(3.0, femur_edge_mm=2.0), name="mine"), folder)


@pytest.fixture
def edited(example: Path, tmp_path: Path) -> Callable[..., Path]:
    """Makes a copy of the example in which a piece of subject.toml is another."""

    def edit(old: str = "", new: str = "") -> Path:
        folder = tmp_path / "subject"
        shutil.copytree(example, folder, dirs_exist_ok=True)
        file = folder / "subject.toml"
        text = file.read_text(encoding="utf-8")
        assert old in text
        file.write_text(text.replace(old, new, 1), encoding="utf-8")
        return folder

    return edit


def refused(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_subject(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.remedy.endswith((".", "?"))
    return message


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_posed_knee_comes_back(tmp_path: Path, side: Side, seed: int) -> None:
    knee = posed_reference(seed, side=side)
    assert_equal(read_subject(posed_folder(tmp_path, seed, side=side)), knee)
    assert [x.name for x in knee.ligaments] == [*NAMES, FIFTH.name]


def test_landmarks_and_odd_names_come_back(tmp_path: Path) -> None:
    knee = posed_reference(2)
    knee = replace(
        knee,
        name='a "b" \\ c \u00e9 \x7f',
        landmarks=(Landmark(name="hip_centre", position=knee.femur_frame.to_common([0, 400, 9])),),
    )
    assert_equal(read_subject(write_subject(knee, tmp_path)), knee)


def test_a_left_folder_holds_the_mirrored_knee(tmp_path: Path) -> None:
    knee = posed_reference(3)
    read_left = read_surface(write_subject(knee, tmp_path) / "femur.ply")
    np.testing.assert_array_equal(read_left.vertices, knee.femur.vertices * [1.0, 1.0, -1.0])


def test_the_contact_law_of_a_fitted_knee_comes_back(tmp_path: Path) -> None:
    knee = replace(posed_reference(0), contact_rounding_mm=0.15)
    read = read_subject(write_subject(knee, tmp_path / "subject"))
    assert read.contact_rounding_mm == 0.15
    assert knee_digest(read) != knee_digest(replace(read, contact_rounding_mm=0.0))


def test_reference_is_a_word() -> None:
    knee = read_subject("reference")
    assert knee.name == "reference"
    assert knee.femur_distance is not None


def test_the_file_is_as_good_as_its_folder(example: Path) -> None:
    assert read_subject(example / "subject.toml").name == "mine"


def test_no_trace_of_the_writing(example: Path) -> None:
    assert sorted(x.name for x in example.iterdir()) == [
        "femur.ply",
        "subject.toml",
        "tibia_lateral.ply",
        "tibia_medial.ply",
    ]


def test_an_unwritable_place(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: a file"):
        write_subject(posed_reference(), tmp_path / "file")


@pytest.mark.parametrize("name", ["subject", "subject/subject.toml"])
def test_missing_subject(tmp_path: Path, name: str) -> None:
    assert "such subject" in refused(tmp_path / "subject")
    (tmp_path / "subject").mkdir()
    assert "subject.toml" in refused(tmp_path / name).removeprefix(str(tmp_path / name))


def test_landmarks_instead_of_frames(edited: Callable[..., Path]) -> None:
    knee = read_subject(edited(AXES, LANDMARKS))
    np.testing.assert_allclose(knee.femur_frame.axes, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(knee.tibia_frame.origin, 0.0, atol=PLACE)
    assert {x.name for x in knee.landmarks} >= {"hip_centre", "medial_epicondyle"}


def test_frames_win_over_landmarks(edited: Callable[..., Path]) -> None:
    tilted = LANDMARKS.replace("[0.0, 400.0, 0.0]", "[80.0, 390.0, 0.0]")
    knee = read_subject(edited(AXES, AXES + tilted))
    np.testing.assert_array_equal(knee.femur_frame.axes, np.eye(3))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("format = 1", "", "the key 'format' is missing. Add format = 1"),
        ("format = 1", "format = 2", "format 2 is not known"),
        ("format = 1", "format = ", "this is not TOML"),
        ('name = "mine"', "", "the key 'name' is missing"),
        ('name = "mine"', "name = 3", "key name: 3 is not text"),
        ('name = "mine"', 'naem = "mine"', "Did you mean name?"),
        ('side = "right"', 'side = "both"', 'Write "right" or "left"'),
        ("[surfaces]", "[surface]", "Did you mean surfaces?"),
        ("tibia_medial =", "medial_tibia =", "[surfaces], key medial_tibia: there is no key"),
        ('"femur.ply"', '"nothing.ply"', "nothing.ply: there is no such file"),
        ('"femur.ply"', '"subject.toml"', "surfaces of type .toml are not read"),
        (AXES, "", "Add [frames.femur] and [frames.tibia], or [landmarks]"),
        (AXES, LANDMARKS.replace("hip_centre", "hip"), "Did you mean hip_centre?"),
        (
            AXES,
            LANDMARKS.replace("hip_centre = [0.0, 400.0, 0.0]", ""),
            "define no frames. Give hip_centre",
        ),
        (AXES, AXES.replace("frames.tibia", "frames.shank"), "[frames], key shank"),
        (AXES, AXES[: AXES.index("[frames.tibia]")], "the key 'tibia' is missing"),
        ("axes = [[1.0", "axes = [[2.0", "[frames.femur]: the axes of a frame must be unit"),
        ("axes = [[1.0", "axes = [[-1.0", "must be right-handed"),
        ("axes = [[1.0, 0.0, 0.0], ", "axes = [", "three rows are wanted"),
        ("origin = [0.0, 0.0, 0.0]", "origin = [0.0, 0.0]", "key origin: three numbers are wanted"),
        ("origin = [0.0,", 'origin = ["0.0",', "key origin: '0.0' is not a number"),
        ("origin = [0.0,", "origin = [true,", "True is not a number"),
        ("femur = [1.2,", "femur = [nan,", "ligament ACL, key femur: nan is not a finite number"),
        ("stiffness_kN = 10.0", "stiffness_kN = -10.0", ">= 0 kN, got -10. Correct the value."),
        ("stiffness_kN = 10.0", 'stiffness_kN = "10"', "ligament ACL, key stiffness_kN: '10'"),
        ("stiffness_kN = 10.0", "stiffnes_kN = 10.0", "Did you mean stiffness_kN?"),
        ("tibia = [14.8, -17.4, 3.4]", "tibia = [1.2, -3.3, 8.5]", "ACL has length zero"),
        ("tibia = [14.8, -17.4, 3.4]", "tibia = [1.3, -3.3, 8.5]", "multiply by 1000"),
        ('name = "PCL"', 'name = "ACL"', "two ligaments are called ACL. Rename one of them."),
        ('name = "PCL"', "", "ligament 2: the key 'name' is missing"),
        ('name = "PCL"', 'name = "a.b"', "Rename it."),
        ("[[ligaments]]", "[ligaments]", "this is not TOML"),
        ("format = 1", "format = 1\ncontact_rounding_mm = 2.0", "must be 0 to 0.15 mm, got 2"),
    ],
)
def test_mistakes_in_subject_toml(
    edited: Callable[..., Path], old: str, new: str, said: str
) -> None:
    folder = edited(old, new)
    message = refused(folder)
    assert said in message
    assert str(folder) in message


@pytest.mark.parametrize(
    ("ligaments", "said"),
    [
        ("ligaments = []\n", "the list is empty"),
        ('ligaments = "none"\n', "a list of tables is wanted"),
        ("ligaments = [3]\n", "a list of tables is wanted"),
        ("", "the key 'ligaments' is missing"),
    ],
)
def test_no_ligaments(edited: Callable[..., Path], ligaments: str, said: str) -> None:
    folder = edited("format = 1\n", f"format = 1\n{ligaments}")
    file = folder / "subject.toml"
    text = file.read_text()
    file.write_text(text[: text.index("[[ligaments]]")])
    assert said in refused(folder)


def test_text_of_another_encoding(edited: Callable[..., Path]) -> None:
    folder = edited()
    (folder / "subject.toml").write_bytes('name = "\u00e9"'.encode("latin-1"))
    assert "UTF-8" in refused(folder)


@pytest.mark.parametrize("name", ["femur", "tibia_medial", "tibia_lateral"])
def test_metres_and_flipped_normals(edited: Callable[..., Path], name: str) -> None:
    folder = edited()
    path = folder / f"{name}.ply"
    surface = read_surface(path)
    write_surface(surface.scaled(1e-3), path)
    message = refused(folder)
    assert name in message
    assert "multiply by 1000" in message
    write_surface(Surface(vertices=surface.vertices, faces=surface.faces[:, ::-1]), path)
    message = refused(folder)
    assert name in message
    assert "the normals" in message


def test_landmarks_in_metres(edited: Callable[..., Path]) -> None:
    metres = LANDMARKS.replace("400.0", "0.4").replace("40.0", "0.04")
    assert "landmarks" in refused(edited(AXES, AXES + metres))


@pytest.mark.parametrize(("side", "other"), [("right", "left"), ("left", "right")])
def test_the_wrong_side(tmp_path: Path, side: Side, other: str) -> None:
    file = posed_folder(tmp_path, side=side) / "subject.toml"
    file.write_text(file.read_text().replace(f'side = "{side}"', f'side = "{other}"'))
    assert f'Write side = "{side}"' in refused(tmp_path)


@pytest.mark.parametrize(("side", "other"), [("right", "left"), ("left", "right")])
def test_the_wrong_side_with_landmarks(tmp_path: Path, side: Side, other: Side) -> None:
    """Landmarks alone give a frame that looks backwards on the wrong side."""
    knee = posed_reference(side=side)
    places = {
        "hip_centre": [0.0, 400.0, 0.0],
        "ankle_centre": [0.0, -400.0, 0.0],
        "medial_epicondyle": [0.0, 0.0, -40.0],
        "lateral_epicondyle": [0.0, 0.0, 40.0],
    }
    marks = tuple(
        Landmark(name=name, position=knee.femur_frame.to_common(x)) for name, x in places.items()
    )
    folder = write_subject(replace(knee, landmarks=marks), tmp_path)
    file = folder / "subject.toml"
    text = file.read_text()
    start, end = text.index("[frames.femur]"), text.index("[landmarks]")
    file.write_text(text[:start] + text[end:])
    back = read_subject(folder)
    np.testing.assert_allclose(back.femur_frame.axes, knee.femur_frame.axes, atol=PLACE)
    file.write_text(file.read_text().replace(f'side = "{side}"', f'side = "{other}"'))
    message = refused(folder)
    assert f'Write side = "{side}"' in message


@pytest.mark.parametrize("name", [".\\\\Femur.PLY", "FEMUR.ply", "C:\\\\meshes\\\\..\\\\femur.ply"])
def test_a_surface_may_have_a_name_of_windows_or_in_another_case(tmp_path: Path, name: str) -> None:
    knee = reference_knee(3.0, femur_edge_mm=3.0)
    write_subject(knee, tmp_path)
    file = tmp_path / "subject.toml"
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace('"femur.ply"', f'"{name}"'), encoding="utf-8")
    if name.startswith("C"):
        with pytest.raises(InputError, match="no such file"):
            read_subject(tmp_path)
    else:
        assert len(read_subject(tmp_path).femur.faces) == len(knee.femur.faces)
