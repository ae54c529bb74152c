"""Named subjects on the command line: their list, and a name where a path is wanted."""

import json
import re
from pathlib import Path

import pytest
from cli_runs import refused, run, short_protocol, summary_in

import identknee as ik
from identknee.laxity.named_tables import TABLES
from identknee.runs.files import digest


def test_the_list_tells_source_licence_and_laxity() -> None:
    result = run("subject", "list")
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    row = lines.index("s192803: left knee, 25 measured trials, licence CC0-1.0")
    assert lines[row + 1].split() == ["4", "ligaments:", "ACL,", "PCL,", "LCL,", "MCL"]
    assert lines[row + 2].endswith("Dryad, doi:10.5061/dryad.zkh1893gw")
    (other,) = (x for x in lines if x.startswith("lenhart2015: right knee,"))
    assert "no measured" in other
    assert other.endswith(" Apache-2.0")


def test_the_list_as_json() -> None:
    result = run("subject", "list", "--json")
    assert result.exit_code == 0, result.output
    subjects = {x["name"]: x for x in json.loads(result.stdout)["subjects"]}
    assert list(subjects) == [
        *("reference", "lenhart2015", "lenhart2015_stable", "s192803", "s192803_bundles")
    ]
    assert [x["has_measured_laxity"] for x in subjects.values()] == [False] * 3 + [True] * 2
    assert [x["has_opensim_model"] for x in subjects.values()] == [False, True] + [False] * 3
    bundles = subjects["s192803_bundles"]
    assert bundles["side"] == "left"
    assert len(bundles["ligaments"]) == 14
    assert bundles["licence"] == "CC0-1.0"


def test_a_name_is_simulated(tmp_path: Path) -> None:
    words = ["--protocol", short_protocol(tmp_path), "--out", tmp_path / "out"]
    result = run("simulate", "lenhart2015_stable", *words)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    summary = summary_in(tmp_path / "out")
    assert summary["subject"] == "lenhart2015_stable"
    assert summary["record"]["settings"]["subject"] == "lenhart2015_stable"


@pytest.mark.slow
@pytest.mark.usefixtures("short_searches", "no_conventions")
def test_a_name_stands_for_data_too(tmp_path: Path) -> None:
    words = ("--budget", 5, "--more-starts", 0, "--out", tmp_path)
    run("fit", "s192803", "s192803", *words)
    summary = summary_in(tmp_path)
    assert summary["rmse"]["n_compared"] + summary["rmse"]["n_missing"] == 120
    assert summary["record"]["settings"]["data"] == "s192803"
    assert summary["record"]["inputs"]["data"] == digest(TABLES["s192803"])
    # The row that cannot be right is a finding of every fit.
    assert "Valgus_60" in [x["where"] for x in summary["findings"]]


def test_a_name_wins_over_what_is_called_so_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ik.write_subject(ik.reference_knee(3.0, femur_edge_mm=3.0), tmp_path / "lenhart2015")
    monkeypatch.chdir(tmp_path)
    result = run("subject", "export", "lenhart2015", "--out", "shipped")
    assert result.exit_code == 0, result.output
    assert re.fullmatch(r"identknee: lenhart2015 .* \./lenhart2015 .*\n", result.stderr)
    assert ik.read_subject("shipped").name == "lenhart2015"
    result = run("subject", "export", "./lenhart2015", "--out", "mine")
    assert (result.exit_code, result.stderr) == (0, "")
    assert ik.read_subject("mine").name == "reference"


def test_mistyped_names_are_answered_with_the_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said = refused("simulate", "lenhart2051_stable")
    assert re.search(r"lenhart2015_stable\?.* reference, lenhart2015,", said)
    assert "s192803?" in refused("fit", "s192803", "s129803")
