"""`identknee fit`, from its words to its files and sentences."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from cli_runs import refused, run, short_protocol, summary_in
from held import fixing

import identknee as ik

# Where least squares stops, and what a fit through the solver can reach.
EXACT_KN_OR_PCT = 1e-6


def noise_free(folder: Path) -> Path:
    """A table of 63 trials of the reference knee."""
    simulation = ik.simulate(ik.reference_knee(), ik.load_protocol("seed63"))
    return ik.write_laxity(simulation.laxity, folder / "data.csv")


def test_noise_free_data_give_back_their_parameters(tmp_path: Path) -> None:
    result = run(
        "fit", "reference", noise_free(tmp_path), "--start", "IG3", "--out", tmp_path / "fit"
    )
    assert result.exit_code == 0, result.output
    summary = summary_in(tmp_path / "fit")
    assert summary["outcome"] == "minimum"
    assert set(summary["parameters"]) == {"ACL", "PCL", "LCL", "MCL"}
    for ligament in ik.reference_knee().ligaments:
        fitted = summary["parameters"][ligament.name]
        assert fitted["stiffness_kN"] == pytest.approx(ligament.stiffness_kN, abs=EXACT_KN_OR_PCT)
        assert fitted["reference_strain_pct"] == pytest.approx(
            ligament.reference_strain_pct, abs=EXACT_KN_OR_PCT
        )
    assert summary["rmse"]["mm"] < EXACT_KN_OR_PCT
    assert summary["rmse"]["deg"] < EXACT_KN_OR_PCT
    assert summary["objective"] < EXACT_KN_OR_PCT**2
    assert 1 < summary["n_simulations"] < 30
    assert summary["seconds"] > 0.0
    assert summary["rmse"]["n_missing"] == 0


def test_the_arrays_hold_the_fit(tmp_path: Path) -> None:
    data = noise_free(tmp_path)
    result = run("fit", "reference", data, "--start", "IG2", "--out", tmp_path, "--json")
    summary = json.loads(result.stdout)
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        groups = {"constant_data", "observed_data", "predictions", "optimization", "errors"}
        assert set(tree.children) == groups
        fit = tree["optimization"].dataset
        theta = fit["theta"].sel(parameter="ACL.stiffness_kN").item()
        assert theta == summary["parameters"]["ACL"]["stiffness_kN"]
        assert fit["history"][-1, 1].item() == summary["objective"]


def test_fixed_parameters_stay_and_bounds_hold(tmp_path: Path) -> None:
    words = ["--fix", "PCL.stiffness_kN", "--bounds", "ACL.stiffness_kN=5:9.9"]
    run("fit", "reference", noise_free(tmp_path), "--start", "IG2", *words, "--out", tmp_path)
    summary = summary_in(tmp_path)
    assert summary["parameters"]["PCL"]["stiffness_kN"] == 17.5
    assert summary["parameters"]["ACL"]["stiffness_kN"] <= 9.9
    assert summary["search"]["fixed"] == ["PCL.stiffness_kN"]


def test_a_search_ends_at_its_budget_and_repeats_with_its_seed(tmp_path: Path) -> None:
    data = noise_free(tmp_path)
    words = ["fit", "reference", data, "--method", "complex", "--budget", "30", "--seed", "5"]
    for name in ("a", "b"):
        assert run(*words, "--start", "IG4", "--out", tmp_path / name).exit_code == 0
    first, second = summary_in(tmp_path / "a"), summary_in(tmp_path / "b")
    assert first["outcome"] == "budget"
    assert first["n_simulations"] == 30
    assert first["parameters"] == second["parameters"]
    assert first["record"]["seed"] == 5


def test_noise_weighting_and_priors_run_on_noisy_data(tmp_path: Path) -> None:
    run("simulate", "reference", "--noise", "0.3mm,0.3deg", "--out", tmp_path / "data")
    words = ["--weighting", "noise", "--priors", "--start", "subject"]
    result = run(
        "fit", "reference", tmp_path / "data" / "laxity.csv", *words, "--out", tmp_path / "fit"
    )
    assert result.exit_code == 0, result.output
    # Five standard errors of the RMSE of 189 and 126 values with sd 0.3.
    summary = summary_in(tmp_path / "fit")
    assert summary["rmse"]["mm"] == pytest.approx(0.3, abs=5 * 0.3 / np.sqrt(2 * 189))
    assert summary["rmse"]["deg"] == pytest.approx(0.3, abs=5 * 0.3 / np.sqrt(2 * 126))


def test_no_ligament_name_or_number_is_built_in(tmp_path: Path) -> None:
    knee = ik.reference_knee(edge_mm=2.0)
    renamed = [replace(x, name=f"line {i}") for i, x in enumerate(knee.ligaments)]
    acl = knee.ligament("ACL")
    fifth = replace(acl, name="bündel", femur=acl.femur + 3.0, stiffness_kN=2.0)
    subject = knee.with_ligaments([*renamed, fifth])
    ik.write_subject(subject, tmp_path / "subject")
    protocol = short_protocol(tmp_path)
    made = run("simulate", tmp_path / "subject", "--protocol", protocol, "--out", tmp_path / "d")
    assert made.exit_code == 0, made.output
    start = tmp_path / "start.toml"
    start.write_text('["line 0"]\nstiffness_kN = 9.0\n', encoding="utf-8")
    data = tmp_path / "d" / "laxity.csv"
    result = run("fit", tmp_path / "subject", data, "--start", start, "--out", tmp_path / "fit")
    assert result.exit_code == 0, result.output
    summary = summary_in(tmp_path / "fit")
    assert set(summary["parameters"]) == {*(f"line {i}" for i in range(4)), "bündel"}
    assert summary["rmse"]["deg"] < 1e-3
    assert re.search(r"IG1\b.*\bACL\b", refused_fit(tmp_path / "subject", data, tmp_path))


def refused_fit(subject: Path, data: Path, out: Path) -> str:
    result = run("fit", subject, data, "--start", "IG1", "--out", out)
    assert result.exit_code == 2
    return result.stderr


def test_a_start_without_prediction_ends_with_1(tmp_path: Path) -> None:
    start = tmp_path / "slack.toml"
    tables = [f"[{name}]\nstiffness_kN = 0.0" for name in ("ACL", "PCL", "LCL", "MCL")]
    start.write_text("\n".join(tables), encoding="utf-8")
    result = run(
        *("fit", "reference", noise_free(tmp_path), "--start", start, "--out", tmp_path / "fit"),
        *fixing(f"{name}.stiffness_kN" for name in ("ACL", "PCL", "LCL", "MCL")),
    )
    assert result.exit_code == 1
    assert "nothing-fitted" in result.stderr
    assert "another --start" in result.stdout
    summary = summary_in(tmp_path / "fit")
    assert summary["outcome"] == "start_failed"
    assert summary["objective"] is None
    # A start is no fit, on the terminal as in the file.
    assert "good fit" not in result.stdout
    assert "fitted" not in result.stdout.replace("was fitted", "")
    nothing, reason = summary["findings"]
    assert (nothing["code"], reason["code"]) == ("nothing-fitted", "trials-without-equilibrium")
    assert (nothing["values"]["n_lost"], nothing["values"]["n_measured"]) == (63, 63)
    assert reason["values"]["outcome"] == "unconstrained"
    assert reason["values"]["trials"][:2] == ["flexion0_varus-10Nm", "flexion0_varus-8Nm"]
    lost = summary["trials_without_equilibrium"]
    assert len(lost) == 63
    assert lost[0]["outcome"] == "unconstrained"


def test_wrong_words_are_refused(tmp_path: Path) -> None:
    data = noise_free(tmp_path)

    def said(*words: str | Path) -> str:
        return refused("fit", "reference", data, "--out", tmp_path / "fit", *words)

    assert re.search("'IG5'.* subject, IG1, ", said("--start", "IG5"))
    assert "none.toml" in said("--start", tmp_path / "none.toml")
    assert re.search("'simplex'.* least-squares", said("--method", "simplex"))
    assert "parameter 'ACL'" in said("--fix", "ACL")
    assert "LOWER:UPPER" in said("--bounds", "ACL.stiffness_kN=3")
    negative = said("--bounds", "ACL.stiffness_kN=-3:3")
    assert re.search(r"lower .*ACL\.stiffness_kN .* 0 ", negative)
    assert re.search("budget.* 1 .* 0$", said("--budget", "0"))
    assert "standard deviation" in said("--weighting", "noise")
    assert not (tmp_path / "fit" / "result.json").exists()


def test_wrong_tables_are_refused_with_row_and_column(tmp_path: Path) -> None:
    data = tmp_path / "data.csv"

    def said(*lines: str) -> str:
        data.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return refused("fit", "reference", data, "--out", tmp_path)

    head = "trial,flexion_deg,varus_moment_Nm,varus_deg"
    assert f"{data}, row 2, column varus_deg: 'three'" in said(head, "a,0,5,three")
    twice = said(head, "a,0,5,3", "a,0,5,3")
    assert re.search("row 3, column trial: 'a' .*row 2", twice)
    assert re.search("varus_moment_Nm.* 1000", said(head, "a,0,5000,3"))
    assert "varus_deg: 'NaN'" in said(head, "a,0,5,NaN")
    unknown = said("trial,flexion_deg,varus", "a,0,5")
    assert re.search(r"column varus: .* varus_deg\?", unknown)
    none = tmp_path / "none.csv"
    assert refused("fit", "reference", none, "--out", tmp_path).startswith(f"{none}: ")


def test_a_missing_argument_shows_the_usage() -> None:
    result = run("fit", "reference")
    assert result.exit_code == 2
    assert "DATA.csv" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_a_mirrored_rotation_is_said(tmp_path: Path) -> None:
    run("simulate", "reference", "--noise", "0.5mm,0.5deg", "--out", tmp_path / "data")
    measured = ik.read_laxity(tmp_path / "data" / "laxity.csv")
    mirrored = replace(measured, coordinates=measured.coordinates * [1.0, 1.0, 1.0, 1.0, -1.0])
    data = ik.write_laxity(mirrored, tmp_path / "mirrored.csv")
    right = run("fit", "reference", tmp_path / "data" / "laxity.csv", "--out", tmp_path / "right")
    assert summary_in(tmp_path / "right")["findings"] == []
    assert "good fit" in right.stdout
    wrong = run("fit", "reference", data, "--start", "IG2", "--out", tmp_path / "wrong")
    # Nothing fitted to such a table holds; the results are written to show why.
    assert wrong.exit_code == 1
    summary = summary_in(tmp_path / "wrong")
    assert summary["rmse"]["deg"] > 5.0
    found = {x["code"]: x for x in summary["findings"]}
    assert summary["findings"][0]["code"] == "broken-convention"
    assert found["broken-convention"]["values"]["what"] == "negating internal_deg"
    assert found["broken-convention"]["severity"] == "error"
    assert {"misfit-gross", "error-large"} & found.keys()
    assert set(summary["at_bounds"]) <= set(found["at-bound"]["values"]["parameters"])
    assert "good fit" not in wrong.stdout
    assert f"Error: {found['broken-convention']['sentence']}" in wrong.stdout


def test_a_misfit_of_no_known_convention_is_no_matter_of_the_start(tmp_path: Path) -> None:
    protocol = ik.load_protocol(short_protocol(tmp_path))
    simulated = ik.simulate("reference", protocol, noise="0.5mm,0.5deg").noisy
    assert simulated is not None
    larger = replace(simulated, coordinates=simulated.coordinates * [1.0, 1.0, 1.0, 1.0, 1.5])
    answer = ik.fit("reference", larger, start="IG2")
    found = {x.where: x for x in answer.findings}
    assert found["data"].code == "misfit-improbable"
    # All searches of a fit from IG2 end where one from the subject's own values does.
    other = ik.fit("reference", larger)
    assert answer.objective == pytest.approx(other.objective, rel=1e-6)
    alone = ik.fit("reference", larger, start="IG2", more_starts=0)
    assert alone.objective >= answer.objective
