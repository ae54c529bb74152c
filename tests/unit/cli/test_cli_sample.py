"""`identknee sample`, from its words to its files and sentences."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from cli_runs import refused, run, short_protocol
from held import fixing

import identknee as ik

NAMES = ("PCL", "LCL", "MCL")
HELD = fixing(f"{name}.stiffness_kN" for name in NAMES)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Noisy laxity of the reference knee in ten trials."""
    folder = tmp_path_factory.mktemp("sample")
    protocol = ik.load_protocol(short_protocol(folder))
    laxity = ik.simulate(ik.reference_knee(), protocol).laxity
    noisy = ik.add_noise(laxity, sd_mm=0.5, sd_deg=0.5, seed=1)
    return ik.write_laxity(noisy, folder / "data.csv")


def test_a_short_sample_and_its_files(table: Path, tmp_path: Path) -> None:
    words = ("sample", "reference", table, *HELD, "--budget", 700, "--out", tmp_path)
    result = run(*words, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["outcome"] == "budget"
    assert summary["quantities"] == {}
    assert summary["rhat_max"] > 0.9
    assert summary["ess_min"] > 0
    assert set(summary["gate"]) >= {"steps_per_tau", "tau_drift", "mean_error"}
    assert summary["record"]["verb"] == "sample"
    assert "PCL.stiffness_kN" not in summary["parameters"]
    one = summary["parameters"]["ACL.stiffness_kN"]
    assert one["q025"] < one["mean"] < one["q975"]
    assert one["leans_on"] in {"data", "prior", "both", "neither"}
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        theta = tree["posterior"]["theta"]
        assert theta.dims == ("chain", "draw", "parameter")
        assert theta.sizes["chain"] == 40
        assert set(np.unique(tree["sample_stats"]["ensemble"])) == {0, 1, 2, 3}
        assert float(theta.sel(parameter="ACL.stiffness_kN").mean()) == pytest.approx(one["mean"])
        predictive = tree["posterior_predictive"]
        assert predictive["tension_N"].dims == ("chain", "draw", "trial", "ligament")
        assert predictive["coordinates"].sizes["trial"] == 10
        for group in ("sample_stats", "log_likelihood", "log_prior", "prior", "observed_data"):
            assert group in tree.children
    # The same command has nothing left to do and says the same.
    again = run(*words, "--json")
    repeated = json.loads(again.stdout)
    assert repeated["parameters"] == summary["parameters"]
    # Predictions can be asked for afterwards: the draws are those that are stored.
    name, force = "contact.lateral_N@flexion30_varus4Nm", "LCL.tension_N@flexion30_varus4Nm"
    more = run(*words, "--quantity", name, "--quantity", force, "--json")
    assert more.exit_code == 0, more.output
    asked = json.loads(more.stdout)
    assert asked["parameters"] == summary["parameters"]
    assert asked["quantities"][name]["q025"] < asked["quantities"][name]["mean"]
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        predictive = tree["posterior_predictive"]
        draws = predictive["quantities"].sel(quantity=force)
        tension = predictive["tension_N"].sel(trial="flexion30_varus4Nm", ligament="LCL")
        assert np.array_equal(draws, tension)
        assert float(draws.mean()) == pytest.approx(asked["quantities"][force]["mean"])


@pytest.mark.slow
def test_basins_of_a_sweep_are_where_it_starts(table: Path, tmp_path: Path) -> None:
    theta = {"ACL.stiffness_kN": 9.0, "ACL.reference_strain_pct": 7.5}
    theta |= {f"{x}.reference_strain_pct": 1.0 for x in NAMES}
    path = tmp_path / "sweep.json"
    path.write_text(json.dumps({"basins": [{"parameters": theta}]}), encoding="utf-8")
    words = ("sample", "reference", table, *HELD, "--budget", 200, "--out", tmp_path / "out")
    moves = ("--moves", "difference", "--workers", 2)
    result = run(*words, *moves, "--basins", path, "--json")
    # What it is given to start at is no fit; the misfit is told at the best fit all the same.
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["optima"] == [list(theta.values())]
    assert summary["record"]["settings"]["moves"] == "difference"
    path.write_text(json.dumps({"basins": []}), encoding="utf-8")
    assert "no basin" in refused(*words, "--basins", path)
    path.write_text(json.dumps({"fit": []}), encoding="utf-8")
    assert "list basins" in refused(*words, "--basins", path)


@pytest.mark.slow
def test_other_data_in_the_folder_of_an_unfinished_run_are_refused(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As a run that was killed leaves it.
    monkeypatch.setattr("identknee.verbs.verb.finish_work", lambda _: None)
    words = (*HELD, "--budget", 100, "--out", tmp_path)
    assert run("sample", "reference", table, *words).exit_code == 0
    other = ik.write_laxity(
        ik.add_noise(
            ik.simulate(ik.reference_knee(), ik.read_laxity(table).protocol).laxity,
            sd_mm=0.5,
            sd_deg=0.5,
            seed=2,
        ),
        tmp_path / "other.csv",
    )
    assert "inputs.data" in refused("sample", "reference", other, *words)


def test_wrong_moves_are_refused(table: Path, tmp_path: Path) -> None:
    words = ("--moves", "walk", "--out", tmp_path)
    assert "moves 'walk'" in refused("sample", "reference", table, *words)
