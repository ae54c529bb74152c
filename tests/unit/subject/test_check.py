import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from posed_knees import posed_reference
from scipy.spatial.transform import Rotation

from identknee.mechanics.closest_point import mesh_distance
from identknee.model.laxity_model import contact_geometry
from identknee.runs.declare import Array, IntArray
from identknee.runs.errors import InputError
from identknee.runs.findings import Severity
from identknee.subject import femoral_distance
from identknee.subject.anatomy import anatomy
from identknee.subject.check import GeometryFinding, check_geometry, fatal_geometry_findings
from identknee.subject.folder import example, read_subject, write_subject
from identknee.subject.knee import Frame, Knee, Landmark, Side
from identknee.subject.opensim import import_opensim
from identknee.subject.reference import reference_knee
from identknee.subject.surface import Surface, joined


@pytest.fixture(scope="module")
def knee() -> Knee:
    return reference_knee(3.0, femur_edge_mm=2.0)


def alarming(findings: tuple[GeometryFinding, ...]) -> list[GeometryFinding]:
    for finding in findings:
        assert finding.sentence.endswith(".")
        assert finding.remedy.endswith(".") or finding.severity is Severity.INFO
    return [x for x in findings if x.severity is not Severity.INFO]


def test_sound_knees_raise_no_alarm(knee: Knee) -> None:
    for sound in (knee, posed_reference(1), posed_reference(2, side="right")):
        assert alarming(check_geometry(sound)) == []
        assert {x.where for x in check_geometry(sound)} == {"tibia_medial", "tibia_lateral"}


def test_named_subjects_raise_no_alarm() -> None:
    for name in ("lenhart2015", "lenhart2015_stable"):
        findings = check_geometry(example(name))
        assert alarming(findings) == []
        assert {x.code for x in findings} == {"surface-contact"}
        assert {round(x.values["depth_mm"], 2) for x in findings} == {0.41, 0.36}


@pytest.mark.slow
def test_the_femur_is_sorted_once_for_contact_and_check(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("identknee.model.laxity_model.cache_folder", lambda: tmp_path)
    built: list[int] = []

    def counted(vertices: Array, faces: IntArray) -> Callable[[Array], Array]:
        built.append(len(faces))
        return mesh_distance(vertices, faces)

    monkeypatch.setattr(femoral_distance, "mesh_distance", counted)
    found = example("lenhart2015_stable")
    knee = replace(found, femur=found.femur.moved(np.eye(3), [0.0, 0.01, 0.0]))
    contact_geometry(knee)
    assert not alarming(check_geometry(knee))
    assert built == [len(knee.femur.faces)]


def _closed(surface: Surface) -> Surface:
    below = surface.moved(np.eye(3), [0.0, -3.0, 0.0])
    n = len(surface.vertices)
    rim = np.array([e for e in surface.edges if _is_rim(surface, e)])
    walls = np.r_[
        np.c_[rim[:, 1], rim[:, 0], rim[:, 0] + n], np.c_[rim[:, 1], rim[:, 0] + n, rim[:, 1] + n]
    ]
    return Surface(
        vertices=np.vstack([surface.vertices, below.vertices]),
        faces=np.vstack([surface.faces, below.faces[:, ::-1] + n, walls]),
    )


def _is_rim(surface: Surface, edge: IntArray) -> bool:
    return any((np.sort(edge) == x).all() for x in surface.boundary_edges)


def _turned(surface: Surface) -> Surface:
    faces = np.array(surface.faces)
    faces[3] = faces[3, ::-1]
    return Surface(vertices=surface.vertices, faces=faces)


def _with_sliver(surface: Surface) -> Surface:
    a, b = surface.vertices[surface.boundary_edges[0]]
    sliver = Surface(vertices=np.array([a, b, (a + b) / 2]), faces=np.array([[0, 1, 2]]))
    return joined(surface, sliver.moved(np.eye(3), [0.0, 0.001, 0.0]))


def _doubled(surface: Surface) -> Surface:
    return joined(surface, surface.moved(np.eye(3), [0.0, 1e-6, 0.0]))


def _finned(surface: Surface) -> Surface:
    a, b, c = surface.faces[0]
    vertices = np.vstack([surface.vertices, surface.vertices[c] - [0.0, 2.0, 0.0]])
    return Surface(vertices=vertices, faces=np.vstack([surface.faces, [[b, a, len(vertices) - 1]]]))


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (_closed, "surface-closed"),
        (_turned, "winding-inconsistent"),
        (_with_sliver, "triangles-degenerate"),
        (_doubled, "vertices-near-duplicate"),
        (_finned, "edges-shared"),
        (lambda x: x.moved(np.eye(3), [0.0, -12.0, 0.0]), "surfaces-apart"),
        (lambda x: x.moved(np.eye(3), [0.0, 9.0, 0.0]), "surfaces-overlap"),
    ],
)
def test_damaged_plateau(knee: Knee, damage: Callable[[Surface], Surface], code: str) -> None:
    damaged = replace(knee, tibia=(damage(knee.tibia[0]), knee.tibia[1]))
    found = [x for x in alarming(check_geometry(damaged)) if x.code == code]
    assert [x.where for x in found] == ["tibia_medial"]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"tibia": [2.0, -5.0, 9.0]}, "ligament-length-odd"),
        ({"tibia": [2.0, -305.0, 9.0]}, "ligament-length-odd"),
        ({"stiffness_kN": 10_000.0}, "stiffness-impossible"),
        ({"stiffness_kN": 500.0}, "stiffness-odd"),
        ({"stiffness_kN": 0.0}, "stiffness-zero"),
    ],
)
def test_odd_ligament(knee: Knee, changes: dict[str, object], code: str) -> None:
    odd = replace(knee.ligaments[0], **changes)  # type: ignore[arg-type]
    findings = alarming(check_geometry(knee.with_ligaments([odd, *knee.ligaments[1:]])))
    assert [(x.code, x.where) for x in findings] == [(code, "ligament ACL")]


def test_strains_as_fractions(knee: Knee) -> None:
    lines = [replace(x, reference_strain_pct=x.reference_strain_pct / 100) for x in knee.ligaments]
    findings = alarming(check_geometry(knee.with_ligaments(lines)))
    assert [x.code for x in findings] == ["strains-as-fractions"]


def turned(axis: tuple[float, float, float], degrees: float) -> Frame:
    axes = Rotation.from_rotvec(np.radians(degrees) * np.array(axis)).as_matrix()
    return Frame(origin=np.zeros(3), axes=axes)


def test_frames_that_fit_no_scan(knee: Knee) -> None:
    for axis, name in (((0.0, 1.0, 0.0), "internal"), ((1.0, 0.0, 0.0), "varus")):
        findings = alarming(check_geometry(replace(knee, femur_frame=turned(axis, 60.0))))
        angles = [x.values["angle"] for x in findings if x.code == "scanned-angle-odd"]
        assert name in angles
    away = Frame(origin=np.array([0.0, 400.0, 0.0]), axes=np.eye(3))
    findings = alarming(check_geometry(replace(knee, femur_frame=away)))
    assert [x.where for x in findings] == ["femur frame"]


def test_size_of_no_knee(knee: Knee) -> None:
    inches = replace(knee, femur=knee.femur.scaled(1 / 25.4))
    assert "femur-size-odd" in {x.code for x in check_geometry(inches)}


def test_landmarks_against_frames(knee: Knee) -> None:
    places = {
        "hip_centre": [0.0, 400.0, 0.0],
        "ankle_centre": [60.0, -400.0, 0.0],
        "medial_epicondyle": [0.0, 0.0, -40.0],
        "lateral_epicondyle": [8.0, 0.0, 40.0],
    }

    def marked(*names: str) -> list[tuple[str, str]]:
        marks = tuple(Landmark(name=x, position=np.array(places[x])) for x in names)
        findings = alarming(check_geometry(replace(knee, landmarks=marks)))
        return [(x.where, x.values["axis"]) for x in findings]

    assert marked(*places) == [
        ("femur frame", "lateral"),
        ("tibia frame", "superior"),
        ("tibia frame", "lateral"),
    ]
    assert marked("hip_centre", "ankle_centre") == [("tibia frame", "superior")]
    assert marked("hip_centre") == []
    assert marked("medial_epicondyle") == []


def test_errors_come_first_and_forbid_use(knee: Knee) -> None:
    femur = Surface(vertices=knee.femur.vertices, faces=knee.femur.faces[:, ::-1])
    odd = replace(knee.ligaments[0], stiffness_kN=0.0)
    wrong = replace(knee, femur=femur, ligaments=(odd,))
    findings = check_geometry(wrong)
    assert [x.severity for x in findings[:2]] == [Severity.ERROR, Severity.WARNING]
    assert [x.line for x in fatal_geometry_findings(wrong)] == [findings[0].line]
    assert findings[0].where == "femur"


def test_exchanged_plateaus(knee: Knee) -> None:
    assert [x.where for x in fatal_geometry_findings(replace(knee, tibia=knee.tibia[::-1]))] == [
        "side"
    ]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"stiffness_kN": 1e4}, "stiffness-impossible"),
        ({"reference_strain_pct": 1e4}, "strain-impossible"),
    ],
)
def test_impossible_ligament(knee: Knee, changes: dict[str, object], code: str) -> None:
    odd = replace(knee.ligaments[0], **changes)  # type: ignore[arg-type]
    (finding,) = fatal_geometry_findings(knee.with_ligaments([odd, *knee.ligaments[1:]]))
    assert finding.code == code
    assert dict(finding.values) == changes
    assert finding.remedy


@pytest.mark.parametrize("side", ["right", "left"])
def test_exchanged_epicondyles_are_named_as_such(tmp_path: Path, side: Side) -> None:
    """And neither a wrong side nor exchanged plateaus is taken for them."""
    knee = reference_knee(edge_mm=2.0)
    write_subject(replace(knee, side=side), tmp_path)
    path = tmp_path / "subject.toml"
    text = re.sub(r"\[frames\.\w+\]\n.*?\n\n", "", path.read_text("utf-8"), flags=re.DOTALL)
    sign = 1 if side == "right" else -1
    places = "[landmarks]\nhip_centre = [0, 400, 0]\nankle_centre = [0, -400, 0]\n"
    places += "{} = [0, 0, {}]\n{} = [0, 0, {}]\n\n[[ligaments]]"

    def read(one: str, other: str, given: str = side) -> Knee:
        marks = places.format(f"{one}_epicondyle", -40 * sign, f"{other}_epicondyle", 40 * sign)
        changed = text.replace("[[ligaments]]", marks, 1).replace(f'"{side}"', f'"{given}"')
        path.write_text(changed, encoding="utf-8")
        return read_subject(tmp_path)

    assert fatal_geometry_findings(read("medial", "lateral")) == ()
    with pytest.raises(InputError, match=r"medial_epicondyle.*lateral_epicondyle"):
        read("lateral", "medial")
    with pytest.raises(InputError, match="Write side = "):
        read("medial", "lateral", "left" if side == "right" else "right")


def _scaled(knee: Knee, factor: float, *, whole: bool = True) -> Knee:
    tibia = tuple(x.scaled(factor) for x in knee.tibia) if whole else knee.tibia
    return replace(knee, femur=knee.femur.scaled(factor), tibia=tibia)


@pytest.mark.parametrize(
    ("factor", "words"), [(0.1, "cm"), (1 / 25.4, "inches"), (1000.0, "micrometres")]
)
@pytest.mark.parametrize("whole", [True, False])
def test_other_units_than_millimetres_are_named(
    knee: Knee, factor: float, words: str, *, whole: bool
) -> None:
    found = fatal_geometry_findings(_scaled(knee, factor, whole=whole))
    assert {x.code for x in found} == {"in-metres"}
    assert found[0].where == "femur"
    assert words in found[0].remedy


def test_a_surface_that_holds_another_is_named(knee: Knee) -> None:
    both = joined(*knee.tibia)
    for tibia in ((both, knee.tibia[1]), (knee.tibia[0], both)):
        (found,) = fatal_geometry_findings(replace(knee, tibia=tibia))
        assert found.code == "surfaces-same"
        assert "holds" in found.sentence
    # As a file in single precision has it, its triangles in another order.
    single = knee.femur.vertices.astype(np.float32).astype(float)
    femur = Surface(vertices=single[::-1], faces=len(single) - 1 - knee.femur.faces)
    (found,) = fatal_geometry_findings(replace(knee, tibia=(femur, knee.tibia[1])))
    assert found.code == "surfaces-same"
    assert found.sentence.startswith("femur and tibia_medial ")
    assert "holds" not in found.sentence


def test_ligaments_on_the_other_side_or_bone_are_named(knee: Knee) -> None:
    mirror = np.array([1.0, 1.0, -1.0])
    mirrored = [replace(x, femur=x.femur * mirror, tibia=x.tibia * mirror) for x in knee.ligaments]
    names = {"MCL": "LCL", "LCL": "MCL"}
    renamed = [replace(x, name=names.get(x.name, x.name)) for x in knee.ligaments]
    turned = [replace(x, femur=x.tibia, tibia=x.femur) for x in knee.ligaments]
    for ligaments, where in (
        (mirrored, ["ligament MCL", "ligament LCL"]),
        (renamed, ["ligament LCL", "ligament MCL"]),
        ([x for x in renamed if x.name != "LCL"], ["ligament MCL"]),
        (turned, ["ligaments"]),
    ):
        found = fatal_geometry_findings(replace(knee, ligaments=tuple(ligaments)))
        assert {x.code for x in found} == {"ligaments-exchanged"}
        assert sorted(x.where for x in found) == sorted(where)


def _replaced(knee: Knee, change: Callable[[Array], Array], *, names: str = "") -> Knee:
    """The knee with the insertions of the ligaments named, or of all, somewhere else."""
    return knee.with_ligaments(
        [
            replace(x, femur=change(x.femur), tibia=change(x.tibia))
            if x.name in (names.split() or [x.name])
            else x
            for x in knee.ligaments
        ]
    )


@pytest.mark.parametrize("plane", [[-1.0, 1.0, 1.0], [1.0, 1.0, -1.0]])
def test_insertions_of_the_other_side_are_named_whatever_ligaments_are_called(
    knee: Knee, plane: list[float]
) -> None:
    own = {x.name: x for x in knee.ligaments}
    off = float((own["ACL"].femur - own["PCL"].femur)[2])
    called = [replace(x, name=f"line{i}") for i, x in enumerate(knee.ligaments)]
    cruciates = {x.name: f"line{i}" for i, x in enumerate(knee.ligaments)}
    mirrored = _replaced(knee.with_ligaments(called), lambda x: x * np.array(plane))
    (found,) = fatal_geometry_findings(mirrored)
    assert (found.code, found.where) == ("ligaments-mirrored", "ligaments")
    ends = ("PCL", "ACL") if plane[0] < 0.0 else ("ACL", "PCL")
    assert list(found.values["forwards"]) == [cruciates[ends[0]]]
    assert list(found.values["backwards"]) == [cruciates[ends[1]]]
    assert found.values["off_mm"] == pytest.approx(off)


def test_a_flexed_scan_is_not_taken_for_a_knee_of_the_other_side() -> None:
    """At -15 deg, and at 140 deg where lines of the posterior capsule cross as cruciates do."""
    for knee in (example("s192803_bundles"), import_opensim("lenhart2015")):
        sites = anatomy(knee)
        middle = (sites.medial.condyle_centre + sites.lateral.condyle_centre) / 2.0
        axis = sites.lateral.condyle_centre - sites.medial.condyle_centre
        for flexion, turn in ((-15.0, 20.0), (60.0, 0.0), (140.0, 0.0), (140.0, -20.0)):
            about = np.radians(flexion) * axis / np.linalg.norm(axis)
            across = Rotation.from_rotvec(np.radians(turn) * knee.tibia_frame.axes[1])
            rotation = (across * Rotation.from_rotvec(about)).as_matrix()
            lines = [
                replace(x, femur=middle + rotation @ (x.femur - middle), wrap=None)
                for x in knee.ligaments
            ]
            assert fatal_geometry_findings(knee.with_ligaments(lines)) == ()


def test_one_ligament_upside_down_is_named(knee: Knee) -> None:
    acl = knee.ligament("ACL")
    rise = float((acl.femur - acl.tibia)[1])
    turned = [
        replace(x, femur=x.tibia, tibia=x.femur) if x.name == "ACL" else x for x in knee.ligaments
    ]
    (found,) = fatal_geometry_findings(knee.with_ligaments(turned))
    assert (found.code, found.where) == ("ligaments-exchanged", "ligament ACL")
    assert found.values["below_mm"] == pytest.approx(rise)


def test_exchanged_names_of_cruciates_are_told_from_a_mirror(knee: Knee) -> None:
    names = {"ACL": "PCL", "PCL": "ACL"}
    renamed = [replace(x, name=names.get(x.name, x.name)) for x in knee.ligaments]
    (found,) = fatal_geometry_findings(knee.with_ligaments(renamed))
    gap = float((knee.ligament("ACL").tibia - knee.ligament("PCL").tibia)[0])
    assert (found.code, found.where) == ("ligaments-exchanged", "ligament ACL")
    assert found.values["off_mm"] == pytest.approx(gap)
    assert "ACL and PCL" in found.remedy


def test_insertions_in_another_frame_are_named(knee: Knee) -> None:
    found = fatal_geometry_findings(_replaced(knee, lambda x: x + np.array([100.0, -900.0, 50.0])))
    assert {(x.code, x.where) for x in found} == {("insertions-elsewhere", "ligaments")}
    assert [x.values["bone"] for x in found] == ["femur", "tibia"]
    for bone, one in zip(("femur", "tibia"), found, strict=True):
        surfaces = (knee.femur,) if bone == "femur" else knee.tibia
        vertices = np.vstack([x.vertices for x in surfaces]) - [100.0, -900.0, 50.0]
        apart = [np.linalg.norm(vertices - getattr(x, bone), axis=1).min() for x in knee.ligaments]
        assert one.values["nearest_mm"] == pytest.approx(min(apart))


def test_one_insertion_far_away_is_named(knee: Knee) -> None:
    far = _replaced(knee, lambda x: x - np.array([90.0, 0.0, 0.0]), names="LCL")
    assert fatal_geometry_findings(far) == ()
    (found,) = alarming(check_geometry(far))
    assert (found.code, found.where) == ("insertion-far", "ligament LCL")
    assert found.values["bone"] == "femur"
    assert 60.0 < found.values["away_mm"] < 85.0


def _pierced(surface: Surface, radius: float) -> Surface:
    centres = surface.vertices[surface.faces].mean(axis=1)
    away = np.linalg.norm(centres - surface.centroid, axis=1)
    return replace(surface, faces=surface.faces[away > radius])


def test_holes_within_a_plateau_are_counted_and_measured(knee: Knee) -> None:
    medial, lateral = knee.tibia
    (found,) = alarming(check_geometry(replace(knee, tibia=(_pierced(medial, 6.0), lateral))))
    assert (found.code, found.where) == ("surface-holes", "tibia_medial")
    assert found.values["n"] == 1
    assert 12.0 < found.values["largest_mm"] < 20.0
    # A part apart has a rim of its own, and the free edges of a fin are no closed line.
    for whole in (joined(medial, medial.moved(np.eye(3), [0.0, -1.0, 0.0])), _finned(medial)):
        codes = {x.code for x in alarming(check_geometry(replace(knee, tibia=(whole, lateral))))}
        assert "surface-holes" not in codes


def test_ligaments_in_their_places_are_sound() -> None:
    for name in ("lenhart2015", "lenhart2015_stable", "s192803", "s192803_bundles", "reference"):
        assert fatal_geometry_findings(example(name)) == ()
    for seed in (1, 2):
        assert fatal_geometry_findings(posed_reference(seed)) == ()
