"""`identknee simulate`, from its words to its files and sentences."""

import json
import re
import stat
from pathlib import Path

import numpy as np
import pytest
import xarray
from cli_runs import refused, run, short_protocol, summary_in

import identknee as ik
from identknee.laxity.table import write_laxity
from identknee.model.laxity_model import LaxityModel


def test_the_table_is_what_the_model_predicts(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    out = tmp_path / "out"
    result = run(
        "simulate", "reference", "--protocol", short, "--set", "ACL.stiffness_kN=9.5", "--out", out
    )
    assert result.exit_code == 0, result.output
    assert "All 10 " in result.stdout
    simulation = ik.simulate(
        ik.reference_knee(), ik.load_protocol(short), {"ACL.stiffness_kN": 9.5}
    )
    read = ik.read_laxity(out / "laxity.csv")
    np.testing.assert_array_equal(read.coordinates, simulation.laxity.coordinates)
    assert read.protocol.trials == simulation.laxity.protocol.trials
    assert read.sd is None


@pytest.mark.slow
def test_the_trials_of_a_measured_table_are_run_as_a_fit_runs_them(tmp_path: Path) -> None:
    table, out = ik.read_laxity("s192803"), tmp_path / "out"
    write_laxity(table, tmp_path / "measured.csv")
    result = run(
        *("simulate", "s192803_bundles", "--protocol", tmp_path / "measured.csv"),
        *("--out", out, "--verbose"),
    )
    assert result.exit_code == 0, result.output
    assert "measured pose" in result.stdout
    knee = ik.read_subject("s192803_bundles")
    model = LaxityModel(knee=knee, protocol=table.protocol).with_tests(table)
    expected = model.predict(model.parameters.start, derivatives=False).coordinates
    read = ik.read_laxity(out / "laxity.csv")
    assert read.protocol.trials == table.protocol.trials
    np.testing.assert_array_equal(read.coordinates, expected)
    # From the unloaded knee most of its trials are not reached.
    assert np.isnan(expected).any(axis=1).sum() <= 1


def test_the_summary_has_the_keys_others_rely_on(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    result = run("simulate", "reference", "--protocol", short, "--out", tmp_path, "--json")
    summary = json.loads(result.stdout)
    assert summary == summary_in(tmp_path)
    assert summary["n_trials"] == summary["n_converged"] == 10
    assert summary["parameters"]["PCL"] == {"stiffness_kN": 18.0, "reference_strain_pct": -4.0}
    assert {"trial", "outcome", "reason"} <= set(summary["trials"][0])
    assert [x["outcome"] for x in summary["trials"]] == ["converged"] * 10
    assert min(x["margin_N_per_mm"] for x in summary["trials"]) > 0.0
    assert summary["record"]["seed"] == 0
    assert summary["record"]["settings"]["protocol"] == str(short)
    assert len(summary["record"]["inputs"]["subject"]) == 64


def test_the_arrays_are_in_named_groups(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    run("simulate", "reference", "--protocol", short, "--noise", "0.1mm,0.2deg", "--out", tmp_path)
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        assert set(tree.children) == {"constant_data", "predictions", "observed_data"}
        table = ik.read_laxity(tmp_path / "laxity.csv").coordinates
        np.testing.assert_array_equal(tree["observed_data"]["coordinates"], table)
        assert tree["predictions"]["tension_N"].dims == ("trial", "ligament")
        assert float(tree["predictions"]["tension_N"].min()) >= 0.0


def test_noise_is_of_the_size_and_seed_given(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    tables = {}
    for name, seed in (("first", "7"), ("again", "7"), ("other", "8")):
        words = ["simulate", "reference", "--protocol", short, "--noise", "0.1mm,0.2deg"]
        run(*words, "--seed", seed, "--out", tmp_path / name)
        tables[name] = ik.read_laxity(tmp_path / name / "laxity.csv")
    sd = tables["first"].sd
    assert sd is not None
    np.testing.assert_array_equal(np.unique(sd, axis=0), [[0.1, 0.1, 0.1, 0.2, 0.2]])
    np.testing.assert_array_equal(tables["first"].coordinates, tables["again"].coordinates)
    assert not np.array_equal(tables["first"].coordinates, tables["other"].coordinates)


def test_correlated_heavy_tailed_noise_is_stated(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    noise = ["--noise", "0.1mm,0.2deg", "--noise-correlation", "0.3", "--noise-student", "4"]
    result = run("simulate", "reference", "--protocol", short, *noise, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert ik.read_laxity(tmp_path / "laxity.csv").within_trial_correlation == 0.3


def test_a_trial_without_equilibrium_is_blank_and_explained(tmp_path: Path) -> None:
    # At 60 deg of flexion the lax knee folds under internal moments; the unloaded trial stays.
    words = ["simulate", "reference", "--protocol", "seed63", "--out", tmp_path]
    lax = [
        "PCL.stiffness_kN=9",
        "ACL.stiffness_kN=5",
        "ACL.reference_strain_pct=5",
        "LCL.reference_strain_pct=-1",
    ]
    result = run(*words, *(word for value in lax for word in ("--set", value)))
    assert result.exit_code == 0, result.output
    summary = summary_in(tmp_path)
    table = ik.read_laxity(tmp_path / "laxity.csv")
    failed = [x["outcome"] != "converged" for x in summary["trials"]]
    assert 0 < sum(failed) < 63
    np.testing.assert_array_equal(np.isnan(table.coordinates).all(axis=1), failed)
    assert re.search(rf"Of 63 .* {63 - sum(failed)} have", result.stdout)
    reason = summary["trials"][failed.index(True)]["reason"]
    assert re.search(r"\d % of ", reason)


def test_a_knee_without_any_equilibrium_ends_with_1(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    slack = [f"{name}.stiffness_kN=0" for name in ("ACL", "PCL", "LCL", "MCL")]
    words = ["simulate", "reference", "--protocol", short, "--out", tmp_path]
    result = run(*words, *(word for value in slack for word in ("--set", value)))
    assert result.exit_code == 1
    assert "the 10 trials" in result.stderr
    assert (tmp_path / "result.json").exists()


def test_a_single_step_is_another_way_to_the_same_place(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    words = ["simulate", "reference", "--protocol", short]
    run(*words, "--out", tmp_path / "a")
    result = run(*words, "--continuation", "single-step", "--out", tmp_path / "b")
    assert result.exit_code == 0, result.output
    first, second = (ik.read_laxity(tmp_path / x / "laxity.csv").coordinates for x in "ab")
    both = ~np.isnan(first) & ~np.isnan(second)
    assert both.any()


def test_the_mesh_law_can_be_chosen(tmp_path: Path) -> None:
    trial = "format = 1\n[[trials]]\nflexion_deg = 0\nvarus_moment_Nm = 2\n"
    (tmp_path / "one.toml").write_text(trial, encoding="utf-8")
    words = ["simulate", "reference", "--protocol", tmp_path / "one.toml", "--out"]
    meshes = run(*words, tmp_path / "mesh", "--contact", "mesh")
    assert meshes.exit_code == 0, meshes.output
    assert "margin" not in meshes.stdout
    run(*words, tmp_path / "field")
    mesh, field = (ik.read_laxity(tmp_path / x / "laxity.csv") for x in ("mesh", "field"))
    # The laws differ by a fraction of a millimetre or degree, not by nothing and not by much.
    difference = np.abs(mesh.coordinates - field.coordinates).max()
    assert 0.0 < difference < 1.0


def test_wrong_words_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    out = tmp_path / "out"

    def said(*words: str) -> str:
        return refused("simulate", "reference", "--protocol", short, "--out", out, *words)

    misspelt = said("--set", "ACL.stifness_kN=9")
    assert re.search(r"'ACL\.stifness_kN'.* ACL\.stiffness_kN\?", misspelt)
    assert "ACL.stiffness_kN=nine" in said("--set", "ACL.stiffness_kN=nine")
    assert "--noise 0.3:" in said("--noise", "0.3")
    assert "ACL.stiffness_kN is -1: " in said("--set", "ACL.stiffness_kN=-1")
    assert "more than 0" in said("--noise", "0mm,1deg")
    assert not out.exists() or not list(out.iterdir())


def test_wrong_protocols_are_refused(tmp_path: Path) -> None:
    misspelt = refused("simulate", "reference", "--protocol", "seed36", "--out", tmp_path)
    assert "seed63?" in misspelt
    mistaken = tmp_path / "mistaken.toml"
    mistaken.write_text(
        'format = 1\n[[ramps]]\nflexion_deg = 0\nload = "varus_moment_Nm"\nvalues = [5000]\n',
        encoding="utf-8",
    )
    said = refused("simulate", "reference", "--protocol", mistaken, "--out", tmp_path)
    assert "5000 N·m is beyond 50 N·m" in said
    assert "by 1000" in said
    none = tmp_path / "none.toml"
    absent = refused("simulate", "reference", "--protocol", none, "--out", tmp_path)
    assert absent.startswith(f"{none}: ")


def test_a_subject_that_is_not_there_is_refused(tmp_path: Path) -> None:
    said = refused("simulate", tmp_path / "nobody", "--out", tmp_path)
    assert str(tmp_path / "nobody") in said


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("taken", encoding="utf-8")
    said = refused("simulate", "reference", "--out", file)
    assert f"{file}: a file" in said


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir()
    locked.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        (locked / "probe").touch()
    except PermissionError:
        said = refused("simulate", "reference", "--out", locked)
        assert str(locked) in said
        assert "written" in said
    else:
        pytest.skip("this user may write anywhere")
    finally:
        locked.chmod(stat.S_IRWXU)


def test_a_seed_below_zero_and_unknown_options_are_refused() -> None:
    for words in (["--seed", "-1"], ["--workers", "0"], ["--sed", "1"]):
        result = run("simulate", "reference", *words)
        assert result.exit_code == 2
        assert "Traceback" not in result.stderr
        assert words[0] in result.stderr


def test_values_come_from_a_start_and_single_ones_from_set(tmp_path: Path) -> None:
    short = short_protocol(tmp_path)
    words = ["simulate", "reference", "--protocol", short, "--json"]
    guess = json.loads(run(*words, "--start", "IG4", "--out", tmp_path / "guess").stdout)
    assert guess["parameters"]["PCL"] == {"stiffness_kN": 8.0, "reference_strain_pct": 4.0}
    start = tmp_path / "start.toml"
    start.write_text("[ACL]\nstiffness_kN = 9.5\nreference_strain_pct = 7.5\n", encoding="utf-8")
    both = run(*words, "--start", start, "--set", "ACL.stiffness_kN=9", "--out", tmp_path / "file")
    found = json.loads(both.stdout)
    assert found["parameters"]["ACL"] == {"stiffness_kN": 9.0, "reference_strain_pct": 7.5}
    assert found["parameters"]["PCL"] == {"stiffness_kN": 18.0, "reference_strain_pct": -4.0}
    assert set(found["record"]["inputs"]) == {"subject", "start", "protocol"}
    simulation = ik.simulate(
        ik.reference_knee(),
        ik.load_protocol(short),
        {"ACL.stiffness_kN": 9.0, "ACL.reference_strain_pct": 7.5},
    )
    read = ik.read_laxity(tmp_path / "file" / "laxity.csv")
    np.testing.assert_array_equal(read.coordinates, simulation.laxity.coordinates)
    unknown = refused(*words[:-1], "--start", "IG9", "--out", tmp_path)
    assert re.search("'IG9'.* subject, IG1, ", unknown)
