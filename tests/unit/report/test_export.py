"""What is written for other tools says what the model says."""

import base64
import csv
import io
import math
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import identknee as ik
from identknee.model.laxity_model import LaxityModel
from identknee.report.export import TYPES, export_subject, write_poses
from identknee.subject.knee import Knee

# Of a compartment's force, that of its triangles against that of the contact points.
MESH_ERROR = 0.06
SINGLE = 1e-4  # mm; points have single precision


@pytest.fixture(scope="module")
def knee() -> Knee:
    return ik.reference_knee(1.6)


def arrays_of(path: Path) -> dict[str, Any]:
    """The arrays of a .vtp file by name, as its format says how to read them."""
    found: dict[str, Any] = {}
    for element in ET.parse(path).getroot().iter("DataArray"):
        name, text = element.attrib["Name"], element.text or ""
        if element.attrib["type"] == "String":
            words = bytes(int(x) for x in text.split()).decode()
            found[name] = words.split("\0")[:-1]
            continue
        # Four numbers of four bytes take 24 characters.
        sizes = np.frombuffer(base64.b64decode(text[:24]), "<u4")
        data = zlib.decompress(base64.b64decode(text[24:]))
        assert sizes.tolist() == [1, len(data), len(data), len(base64.b64decode(text[24:]))]
        found.setdefault(name, []).append(np.frombuffer(data, TYPES[element.attrib["type"]]))
    return found


@pytest.mark.parametrize("side", ["right", "left"])
def test_faces_carry_the_contact_and_lines_the_forces(
    tmp_path: Path, knee: Knee, side: Any
) -> None:
    knee = replace(knee, side=side)
    model = LaxityModel(knee=knee, protocol=ik.load_protocol("drawer"))
    prediction = model.predict(model.parameters.start, derivatives=False)
    write_poses(model, model.parameters.start, tmp_path)
    files = sorted(tmp_path.glob("*.vtp"))
    assert len(files) == prediction.is_converged.sum()
    found = arrays_of(files[2])
    trial = model.protocol.trials.index(found["trial"][0])
    part, gap = found["part"][0], found["gap_mm"][0]
    tension, pressure = found["tension_N"][0], found["pressure_MPa"][0]
    assert found["parts"] == ["femur", "medial tibia", "lateral tibia", "ACL", "PCL", "LCL", "MCL"]
    np.testing.assert_allclose(
        tension[:4], ik.model.tensions_of(model, prediction)[trial], rtol=1e-6
    )
    assert np.isnan(tension[4:]).all()
    assert np.isnan(gap[:4]).all()
    # With the paper's law the pressure is the overlap times its modulus.
    touching = gap < 0.0
    np.testing.assert_allclose(pressure[touching], -10.0 * gap[touching], rtol=1e-5)
    areas = np.concatenate([x.areas for x in (knee.femur, *knee.tibia)])
    forces = [areas[part[4:] == i] @ pressure[4:][part[4:] == i] for i in range(3)]
    wanted = prediction.centres[trial, :, 0]
    np.testing.assert_allclose(forces[1:], wanted, rtol=MESH_ERROR)
    np.testing.assert_allclose(forces[0], wanted.sum(), rtol=MESH_ERROR)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_femur_stays_where_it_was_scanned(tmp_path: Path, knee: Knee, side: Any) -> None:
    knee = replace(knee, side=side)
    model = LaxityModel(knee=knee, protocol=ik.load_protocol("drawer"))
    write_poses(model, model.parameters.start, tmp_path)
    found = arrays_of(min(tmp_path.glob("*.vtp")))
    points = found["Points"][0].reshape(-1, 3)
    scanned = knee.femur if side == "right" else knee.femur.mirrored()
    n = len(scanned.vertices)
    np.testing.assert_allclose(points[8 : 8 + n], scanned.vertices, atol=SINGLE)
    triangles = found["connectivity"][1].reshape(-1, 3)[: len(scanned.faces)] - 8
    again = ik.subject.Surface(vertices=scanned.vertices, faces=triangles)
    # Seen from outside they turn counter-clockwise on both sides.
    outward = knee.femur.normals * [1.0, 1.0, -1.0 if side == "left" else 1.0]
    np.testing.assert_allclose(again.normals, outward, atol=1e-9)


def test_results_of_one_folder_become_a_table(tmp_path: Path, knee: Knee) -> None:
    results = tmp_path / "results"
    data = ik.simulate(knee, "drawer", noise="0.3mm,0.3deg", seed=1).noisy
    assert data is not None
    fixed = ["LCL.stiffness_kN"]
    fit = ik.fit(knee, data, start="IG4", fixed=fixed, out=results / "fit")
    wanted = ["ACL.stiffness_kN"]
    profiles = ik.profile(knee, data, parameters=wanted, fixed=fixed, out=results / "profile")
    # Of another knee, which counts for nothing.
    ik.simulate(ik.reference_knee(3.0), "drawer", out=results / "other")
    written = export_subject(knee, out=tmp_path / "out", fitted=results)
    rows = {
        x["parameterName"]: x
        for x in csv.DictReader(
            io.StringIO((tmp_path / "out" / "parameters.tsv").read_text()), delimiter="\t"
        )
    }
    names = LaxityModel(knee=knee, protocol=data.protocol).parameters.names
    assert tuple(rows) == names
    row, profile = rows["ACL.stiffness_kN"], profiles.parameters["ACL.stiffness_kN"]
    found = fit.parameters["ACL"]["stiffness_kN"]
    acl = next(x for x in written.ligaments if x.name == "ACL")
    assert float(row["fittedValue"]) == found == acl.stiffness_kN
    assert (float(row["lower95"]), float(row["upper95"])) == (profile.lower, profile.upper)
    assert row["evidence"] == "profile"
    mean, sd = map(float, row["objectivePriorParameters"].split(";"))
    assert (row["objectivePriorType"], sd) == ("logNormal", 0.35)
    assert math.exp(mean) == pytest.approx(10.0)
    assert [x["estimate"] for x in rows.values()].count("0") == 1
    assert rows["LCL.stiffness_kN"]["estimate"] == "0"
    assert rows["PCL.stiffness_kN"]["lower95"] == ""
    with pytest.raises(ValueError, match="lenhart2015_stable"):
        export_subject(ik.example("lenhart2015_stable"), out=tmp_path / "no", fitted=results)
    ik.information(knee, data, out=tmp_path / "information")
    with pytest.raises(ValueError, match="parameter set"):
        export_subject(knee, out=tmp_path / "no", fitted=tmp_path / "information")
