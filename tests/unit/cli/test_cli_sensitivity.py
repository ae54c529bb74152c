"""`identknee sensitivity`, from its words to its files and sentences."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray
from cli_runs import refused, run, short_protocol
from held import both_of, fixing

import identknee as ik

WORDS = ("sensitivity", "reference")
PROTOCOL = "--protocol"


def test_sobol_indices_of_the_laxity(tmp_path: Path) -> None:
    words = (*WORDS, PROTOCOL, short_protocol(tmp_path), "--samples", 4, "--out", tmp_path)
    result = run(*words, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["method"] == "sobol"
    assert summary["n_simulations"] == 4 * 10
    assert 0.0 <= summary["failed_share"] < 1.0
    assert set(summary["indices"]) == {"S1", "ST"}
    assert summary["more_simulations_to_half_width_0.02"] > 0
    assert summary["record"]["verb"] == "sensitivity"
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        data = tree["sensitivity"].dataset["index_by_level"].sel(index="ST")[-1]
        assert data.shape == (5 * 2 * 5 + 1, 8)
        top = summary["indices"]["ST"]["ACL.stiffness_kN"]["largest"]
        stored = data.sel(group=top["group"], parameter="ACL.stiffness_kN").item()
        assert stored == top["value"]
    # More of them, in the same folder, go on from there.
    grown = run(
        *WORDS, PROTOCOL, tmp_path / "short.toml", "--samples", 8, "--out", tmp_path, "--verbose"
    )
    assert grown.exit_code == 0, grown.output
    assert "index ST" in grown.stdout
    assert "of 0.02" in grown.stdout


def test_trials_of_a_table_and_fixed_parameters(tmp_path: Path) -> None:
    protocol = ik.load_protocol(short_protocol(tmp_path)).select([0, 1, 2])
    table = ik.write_laxity(
        ik.simulate(ik.reference_knee(), protocol).laxity, tmp_path / "data.csv"
    )
    held = fixing(f"{name}.stiffness_kN" for name in ("PCL", "LCL", "MCL"))
    words = ("--method", "morris", "--samples", 2, *held, "--out", tmp_path, "--json")
    result = run(*WORDS, table, *words)
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["n_simulations"] == 2 * 6
    assert len(summary["indices"]["mu_star"]) == 5
    assert "PCL.stiffness_kN" not in summary["indices"]["mu_star"]


@pytest.mark.slow
def test_over_a_posterior(tmp_path: Path) -> None:
    parameters = ik.LaxityModel(
        knee=ik.reference_knee(), protocol=ik.load_protocol("table2")
    ).parameters
    draws = parameters.center + 0.05 * np.random.default_rng(0).normal(size=(4, 100, 8))
    theta = (("chain", "draw", "parameter"), draws)
    data = xarray.Dataset({"theta": theta}, coords={"parameter": list(parameters.names)})
    folder = tmp_path / "sample"
    folder.mkdir()
    tree = xarray.DataTree.from_dict({"posterior": data})
    tree.to_netcdf(folder / "result.nc", engine="netcdf4")
    words = ("--method", "pawn", "--posterior", folder, "--out", tmp_path / "out", "--verbose")
    result = run(*WORDS, PROTOCOL, short_protocol(tmp_path), *words)
    assert result.exit_code == 0, result.output
    assert "400 simulations" in result.stdout
    assert "index pawn" in result.stdout


def test_mistakes_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = (PROTOCOL, short_protocol(tmp_path), "--out", tmp_path / "out")
    assert "blocks, got 3" in refused(*WORDS, *short, "--samples", 3)
    names = [x.name for x in ik.reference_knee().ligaments]
    held = fixing(both_of(*names)[1:])
    assert "two parameters" in refused(*WORDS, *short, *held)
    none = refused(*WORDS, *short, "--method", "delta", "--posterior", tmp_path)
    assert str(tmp_path) in none
    assert "no results" in none
    data = ik.write_laxity(
        ik.simulate(ik.reference_knee(), ik.load_protocol("table2")).laxity, tmp_path / "data.csv"
    )
    both = (*WORDS, data, *short)
    assert re.search(r"DATA\.csv .*--protocol", refused(*both))
    # As a run that was killed leaves it.
    monkeypatch.setattr("identknee.verbs.verb.finish_work", lambda _: None)
    run(*WORDS, *short, "--samples", 2)
    other = refused(*WORDS, *short, "--samples", 2, "--seed", 5)
    assert re.search(r"\bseed\b.* 0 .* 5 ", other)
