"""`identknee sweep`: what it finds, says and refuses, and that it resumes."""

import json
from pathlib import Path
from typing import Any

import pytest
import xarray
from cli_runs import refused, run, short_protocol, summary_in

NOISE = ("--noise", "0.5mm,0.5deg")
SHORT = ("--n-starts", 12, "--paths", 4, *NOISE)
SHORTEST = ("--n-starts", 3, "--paths", 1, *NOISE)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Noisy laxity of the reference knee in ten trials."""
    folder = tmp_path_factory.mktemp("laxity")
    words = ("--protocol", short_protocol(folder), "--noise", "0.3mm,0.3deg")
    assert run("simulate", "reference", *words, "--out", folder).exit_code == 0
    return folder / "laxity.csv"


def summary(folder: Path) -> dict[str, Any]:
    """Its result without what differs from run to run."""
    found: dict[str, Any] = summary_in(folder)
    for name in ("record", "seconds", "seconds_per_start"):
        del found[name]
    return found


def test_a_sweep_tells_its_ends_apart(data: Path, tmp_path: Path) -> None:
    shells = ("--design", "shells", "--distances", "0,1,3")
    result = run("sweep", "reference", data, *SHORT, *shells, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "12 least-squares" in result.stdout
    found = summary(tmp_path)
    assert sum(found["kinds"].values()) == found["n_starts"] == 12
    assert found["design"] == "shells"
    assert found["unseen_mass"]["upper"] <= 1.0
    assert found["cliffs"]["n_paths"] == 4
    assert len(found["basins"][0]["parameters"]) == 8
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        assert tree["optimization"]["theta_polished"].shape == (12, 8)
        assert {"optimization", "basins", "recovery", "cliffs", "timing"} < set(tree.children)


def test_the_same_command_again_computes_nothing_and_says_the_same(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("sweep", "reference", data, *SHORTEST, "--method", "complex", "--budget", 25)
    assert run(*words, "--out", tmp_path).exit_code == 0
    first = summary(tmp_path)

    def never(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr("identknee.identify.sweep._end", never)
    monkeypatch.setattr("identknee.identify.cliffs._path", never)
    assert run(*words, "--out", tmp_path).exit_code == 0
    assert summary(tmp_path) == first


def test_another_question_in_the_same_folder_is_a_new_run(data: Path, tmp_path: Path) -> None:
    words = ("sweep", "reference", data, *SHORTEST, "--out", tmp_path)
    assert run(*words).exit_code == 0
    first = summary(tmp_path)
    assert run(*words, "--seed", 1).exit_code == 0
    assert summary(tmp_path) != first


def test_fixed_parameters_are_not_swept_and_json_is_all_that_is_printed(
    data: Path, tmp_path: Path
) -> None:
    fixed = ("--fix", "PCL.stiffness_kN", "--fix", "PCL.reference_strain_pct", "--json")
    result = run("sweep", "reference", data, *SHORTEST, *fixed, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["n_starts"] == 3
    assert len(summary(tmp_path)["basins"][0]["parameters"]) == 6


def test_a_sweep_that_finds_nothing_is_not_computed(data: Path, tmp_path: Path) -> None:
    slack = [x for name in ("ACL", "PCL", "LCL", "MCL") for x in _slack(name)]
    words = ("--n-starts", 2, "--noise", "0.5mm,0.5deg", "--start", _slack_start(tmp_path))
    result = run("sweep", "reference", data, *words, *slack, "--out", tmp_path)
    assert result.exit_code == 1, result.output
    found = summary_in(tmp_path)
    assert "no-prediction" in {x["code"] for x in found["findings"]}
    assert "no-prediction" in result.stderr
    assert "the start" in result.stdout
    assert summary(tmp_path)["kinds"] == {"start_failed": 2}


def _slack(name: str) -> tuple[str, str]:
    return ("--bounds", f"{name}.reference_strain_pct=-15:-14.9")


def _slack_start(folder: Path) -> Path:
    path = folder / "slack.toml"
    tables = [f"[{x}]\nreference_strain_pct = -15.0" for x in ("ACL", "PCL", "LCL", "MCL")]
    path.write_text("\n".join(tables), encoding="utf-8")
    return path


def test_mistakes_are_refused_in_a_sentence(data: Path, tmp_path: Path) -> None:
    words = ("sweep", "reference", data, "--out", tmp_path)
    assert "method 'best'" in refused(*words, *SHORT, "--method", "best")
    shells = ("--design", "shells", "--distances", "near")
    assert "--distances near" in refused(*words, *SHORT, *shells)
    assert "more than 0" in refused(*words, "--noise", "0mm,0deg")
