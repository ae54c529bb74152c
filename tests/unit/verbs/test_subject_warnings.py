"""What the check of a subject warns of stands in every result that rests on the subject."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mesh_defects import binary_stl, with_defect, write_polygons

import identknee as ik
from identknee.runs.errors import InputError
from identknee.runs.findings import Severity
from identknee.subject.check import check_geometry
from identknee.subject.examples import NAMED_SUBJECTS
from identknee.subject.folder import example, write_subject
from identknee.subject.knee import Knee
from identknee.subject.reference import reference_knee
from identknee.subject.surface import read_surface

PROTOCOL = """
format = 1
name = "short"
[[ramps]]
flexion_deg = [0, 30]
load = "internal_moment_Nm"
values = [0, 4]
"""
FAULTS = {
    "quad-last": {"without_area": 35},
    "turned": {"turned": 35},
    "both-sides": {"twice": 35},
    "line": {"without_area": 35},
    "stray": {"unused": 40},
}


@pytest.fixture(scope="module")
def knee() -> Knee:
    return replace(reference_knee(1.2, femur_edge_mm=2.0), femur_distance=None)


def folder_with(knee: Knee, folder: Path, fault: str = "") -> Path:
    """A subject folder whose surfaces have a fault."""
    write_subject(knee, folder)
    text = (folder / "subject.toml").read_text(encoding="utf-8")
    (folder / "subject.toml").write_text(text.replace(".ply", ".obj"), encoding="utf-8")
    for path in folder.glob("*.ply"):
        surface = read_surface(path)
        wrong = with_defect(fault, surface) if fault else (surface.vertices, surface.faces.tolist())
        write_polygons(path.with_suffix(".obj"), *wrong)
    return folder


@pytest.fixture(scope="module")
def protocol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("protocol") / "short.toml"
    path.write_text(PROTOCOL, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def clean(knee: Knee, protocol: Path, tmp_path_factory: pytest.TempPathFactory) -> "ik.Simulation":
    folder = folder_with(knee, tmp_path_factory.mktemp("clean"))
    return ik.simulate(folder, protocol)


@pytest.mark.parametrize("fault", FAULTS)
def test_laxity_with_a_fault_is_that_without(
    tmp_path: Path, knee: Knee, protocol: Path, clean: "ik.Simulation", fault: str
) -> None:
    found = ik.simulate(folder_with(knee, tmp_path / "a", fault), protocol)
    assert clean.n_converged == clean.n_trials
    np.testing.assert_allclose(found.coordinates, clean.coordinates, rtol=0.0, atol=1e-6)
    assert [x.code for x in clean.findings] == []
    told = [x for x in found.findings if x.code == "surface-repaired"]
    assert {x.where for x in told} == {"femur", "tibia_medial", "tibia_lateral"}
    assert {x.severity for x in told} == {Severity.WARNING}
    (medial,) = [x.values for x in told if x.where == "tibia_medial"]
    ((name, _),) = FAULTS[fault].items()
    assert medial[name] > 0
    assert sum(bool(x) for x in medial.values()) == 1


def test_fit_and_check_say_the_same(tmp_path: Path, knee: Knee, protocol: Path) -> None:
    folder = folder_with(knee, tmp_path / "a", "turned")
    data = tmp_path / "data.csv"
    ik.write_laxity(ik.simulate(knee, protocol).laxity, data)
    fitted = ik.fit(folder, data, noise="0.1mm,0.1deg")
    wanted = {
        (x.code, x.where)
        for x in check_geometry(ik.read_subject(folder))
        if x.severity is Severity.WARNING
    }
    assert {x[0] for x in wanted} == {"surface-repaired"}
    assert wanted <= {(x.code, x.where) for x in fitted.findings}


def test_of_knees_that_come_with_identknee_there_is_nothing_to_say() -> None:
    for named in NAMED_SUBJECTS:
        own = example(named.name)
        assert {x.severity for x in check_geometry(own)} == {Severity.INFO}
        assert not any(x.repairs.clauses for x in (own.femur, *own.tibia))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("tibia_medial", "tibia_lateral"),
        ("tibia_lateral", "tibia_medial"),
        ("femur", "tibia_medial"),
    ],
)
def test_one_surface_given_twice_is_refused(
    tmp_path: Path, knee: Knee, first: str, second: str
) -> None:
    folder = write_subject(knee, tmp_path)
    (folder / f"{second}.ply").write_bytes((folder / f"{first}.ply").read_bytes())
    with pytest.raises(InputError, match="the same surface") as caught:
        ik.read_subject(folder)
    assert caught.value.where in (first, second)


@pytest.mark.parametrize("counted", [7, -7])
def test_a_wrong_count_and_bytes_at_the_end(
    tmp_path: Path, knee: Knee, protocol: Path, counted: int
) -> None:
    laxity = []
    for name, more in (("a", False), ("b", True)):
        folder = write_subject(knee, tmp_path / name)
        text = (folder / "subject.toml").read_text(encoding="utf-8")
        (folder / "subject.toml").write_text(
            text.replace("femur.ply", "femur.stl"), encoding="utf-8"
        )
        femur = read_surface(folder / "femur.ply")
        n = len(femur.faces) + (counted if more else 0)
        (folder / "femur.stl").write_bytes(binary_stl(femur, counted=n))
        laxity.append(ik.simulate(folder, protocol))
    np.testing.assert_array_equal(laxity[0].coordinates, laxity[1].coordinates)
    assert [x.where for x in laxity[1].findings if x.code == "surface-repaired"] == ["femur"]
