"""`identknee subject`, from its words to its files and sentences."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from cli_runs import refused, run, short_protocol, summary_in
from osim_files import write_model

import identknee as ik


def test_the_reference_knee_passes_its_check(tmp_path: Path) -> None:
    words = ["--protocol", short_protocol(tmp_path), "--samples", "5", "--workers", "2"]
    result = run("subject", "check", "reference", *words, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    summary = summary_in(tmp_path / "out")
    assert summary["n_errors"] == 0
    assert summary["stability"]["n_converged"] == 10
    assert sum(summary["stability"]["box_outcomes"].values()) == 50
    with xarray.open_datatree(tmp_path / "out" / "result.nc", engine="netcdf4") as tree:
        assert set(tree.children) == {"subject", "stability"}


def test_a_knee_that_cannot_be_held_ends_with_1_and_a_remedy(tmp_path: Path) -> None:
    knee = ik.reference_knee(edge_mm=2.0)
    slack = [replace(x, stiffness_kN=0.0) for x in knee.ligaments]
    ik.write_subject(knee.with_ligaments(slack), tmp_path / "slack")
    words = ["--protocol", short_protocol(tmp_path), "--samples", "0", "--out", tmp_path / "out"]
    result = run("subject", "check", tmp_path / "slack", *words)
    assert result.exit_code == 1
    summary = summary_in(tmp_path / "out")
    assert summary["n_errors"] == 1
    (error,) = [x for x in summary["findings"] if x["severity"] == "error"]
    assert error["code"] == "trials-not-converging"
    assert (error["values"]["n_lost"], error["values"]["n"]) == (10, 10)
    assert error["sentence"] in result.stdout


def test_a_knee_in_metres_is_not_simulated(tmp_path: Path) -> None:
    knee = ik.reference_knee(edge_mm=3.0)
    small = replace(
        knee,
        femur=knee.femur.scaled(1e-3),
        tibia=tuple(x.scaled(1e-3) for x in knee.tibia),
        femur_distance=None,
    )
    try:
        ik.write_subject(small, tmp_path / "metres")
        result = run("subject", "check", tmp_path / "metres", "--out", tmp_path / "out")
    except ValueError as error:
        pytest.fail(f"a subject in metres is a finding, not an exception: {error}")
    assert result.exit_code == 2
    assert "metres" in result.output


def test_a_picture_is_drawn(tmp_path: Path) -> None:
    result = run("subject", "show", "reference", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "scene.png").read_bytes().startswith(b"\x89PNG")
    assert summary_in(tmp_path)["subject"] == "reference"


def test_an_exported_subject_reads_back_as_the_same_knee(tmp_path: Path) -> None:
    result = run("subject", "export", "reference", "--out", tmp_path / "copy")
    assert result.exit_code == 0, result.output
    assert f"subject check {tmp_path / 'copy'}" in result.stdout
    knee, copy = ik.reference_knee(), ik.read_subject(tmp_path / "copy")
    assert [x.name for x in copy.ligaments] == [x.name for x in knee.ligaments]
    # Surface files hold single precision: 1e-7 of 100 mm.
    np.testing.assert_allclose(copy.reference_lengths, knee.reference_lengths, atol=1e-5)
    assert len(copy.femur.faces) == len(knee.femur.faces)


@pytest.mark.slow
def test_a_fit_goes_back_into_the_opensim_model(tmp_path: Path) -> None:
    knee, fit = tmp_path / "knee", tmp_path / "fit"
    run("subject", "import-osim", "lenhart2015", "--bundles", "merged", "--out", knee)
    run("simulate", knee, "--protocol", "drawer", "--set", "ACL.stiffness_kN=7", "--out", fit)
    words = ["--fitted", fit, "--source", "lenhart2015", "--out", tmp_path / "back"]
    result = run("subject", "export", knee, *words)
    assert result.exit_code == 0, result.output
    model = tmp_path / "back" / "lenhart2015.osim"
    assert f"Also written: {model}" in result.stdout
    merged = ik.import_opensim(model, bundles="merged")
    for found in (merged, ik.read_subject(tmp_path / "back")):
        assert found.ligament("ACL").stiffness_kN == pytest.approx(7.0, rel=1e-12)


def test_an_opensim_model_becomes_a_subject(tmp_path: Path) -> None:
    words = ["--bundles", "merged", "--out", tmp_path / "subject", "--json"]
    result = run("subject", "import-osim", "lenhart2015", *words)
    assert result.exit_code == 0, result.output
    names = {x["name"] for x in json.loads(result.stdout)["ligaments"]}
    assert {"ACL", "PCL", "LCL", "MCL"} <= names
    assert len(ik.read_subject(tmp_path / "subject").ligaments) == len(names)


def test_wrong_words_are_refused(tmp_path: Path) -> None:
    said = refused("subject", "check", tmp_path / "nobody", "--out", tmp_path / "out")
    assert str(tmp_path / "nobody") in said
    said = refused("subject", "import-osim", tmp_path / "none.osim", "--out", tmp_path / "out")
    assert "none.osim" in said
    result = run("subject", "import-osim", "x.osim", "--bundles", "all")
    assert result.exit_code == 2
    assert "'separate', 'merged'" in result.stderr


def test_without_a_verb_the_help_is_shown() -> None:
    result = run("subject")
    assert result.exit_code == 2
    assert "import-osim" in result.output


INTERNAL = """
format = 1
name = "internal"
[[ramps]]
flexion_deg = [0, 30]
load = "internal_moment_Nm"
values = [0, 2, 4, 6, 8, 10]
"""


def internal(folder: Path) -> Path:
    """File of a protocol under which a knee folds."""
    path = folder / "internal.toml"
    path.write_text(INTERNAL, encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_knee_that_folds_settles(tmp_path: Path) -> None:
    protocol = internal(tmp_path)
    words = ["lenhart2015", "--protocol", protocol]
    checked = run("subject", "check", *words, "--samples", "0", "--out", tmp_path / "check")
    assert checked.exit_code == 1
    assert "(flexion0_internal4Nm, flexion0_internal6Nm" in checked.stdout
    assert "subject settle" in checked.stdout
    found = summary_in(tmp_path / "check")
    assert "trials-not-converging" in {x["code"] for x in found["findings"]}
    assert len(found["stability"]["moves"]) == 48
    out = tmp_path / "settled"
    settled = run("subject", "settle", *words, "--within", "5", "--out", out)
    assert settled.exit_code == 0, settled.output
    summary = summary_in(out)
    assert summary["n_converged_after"] == summary["n_trials"] > summary["n_converged_before"]
    knee, moved = ik.read_subject("lenhart2015"), ik.read_subject(out)
    distances = {(x["ligament"], x["bone"]): x["distance_mm"] for x in summary["moved"]}
    for old, new in zip(knee.ligaments, moved.ligaments, strict=True):
        for bone in ("femur", "tibia"):
            distance = float(np.linalg.norm(getattr(new, bone) - getattr(old, bone)))
            assert distance == pytest.approx(distances.get((old.name, bone), 0.0), abs=1e-5)
            assert distance < 5.001
    words = ["--protocol", protocol, "--samples", "0", "--out", tmp_path / "again"]
    again = run("subject", "check", out, *words)
    assert again.exit_code == 0, again.output


@pytest.mark.slow
def test_a_knee_that_does_not_settle_ends_with_1(tmp_path: Path) -> None:
    words = ["--protocol", internal(tmp_path), "--within", "0.1", "--out", tmp_path / "out"]
    result = run("subject", "settle", "lenhart2015", *words)
    assert result.exit_code == 1
    assert "with --within" in result.stderr
    far = refused("subject", "settle", "lenhart2015", "--within", "9", "--out", tmp_path)
    assert "8 mm, got 9 mm" in far


def test_what_an_import_left_out_is_printed_and_stored(tmp_path: Path) -> None:
    path = write_model(tmp_path, ik.reference_knee(3.0, femur_edge_mm=2.0))
    text = path.read_text(encoding="utf-8").replace(
        "<linear", "<appliesForce>false</appliesForce><linear", 1
    )
    limit = (
        '<CoordinateLimitForce name="limit"><coordinate>knee</coordinate></CoordinateLimitForce>'
    )
    path.write_text(
        text.replace("<ForceSet><objects>", f"<ForceSet><objects>{limit}"), encoding="utf-8"
    )
    result = run("subject", "import-osim", path, "--side", "right", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    for word in ("ACL (Blankevoort1991Ligament)", "CoordinateLimitForce", "limit"):
        assert word in result.stdout
    told = {x["kind"]: x for x in summary_in(tmp_path / "out")["left_out"]}
    assert told["Blankevoort1991Ligament"]["names"] == ["ACL"]
    assert told["Blankevoort1991Ligament"]["change"] == "left out"
    assert told["CoordinateLimitForce"]["names"] == ["limit"]
    said = refused("subject", "import-osim", path, "--side", "left", "--out", tmp_path / "other")
    assert "left femur" in said
