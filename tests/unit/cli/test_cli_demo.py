"""`identknee demo`, on fewer trials and starts; and how the command is stopped."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray
from cli_runs import run, said, short_protocol, summary_in

import identknee as ik
from identknee.identify.profile.profile import profile_parameters
from identknee.verbs.files import load


@pytest.fixture
def few_trials(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    protocol = ik.load_protocol(short_protocol(tmp_path))
    monkeypatch.setattr("identknee.verbs.demo.load_protocol", lambda _name: protocol)
    monkeypatch.setattr("identknee.verbs.demo.STARTS", ("IG2", "IG4"))


@pytest.mark.usefixtures("few_trials")
def test_the_story_is_told_and_kept(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    result = run("demo", "--runs", "1", "--budget", "60", "--out", out)
    assert result.exit_code == 0, result.output
    assert "Short settings" in result.stderr
    for word in ("Complex", "Least-squares", "IG2", "IG4", "1 out of budget", "1 at a minimum"):
        assert word in result.stdout
    assert {x.name for x in out.iterdir()} == {
        "knee.png",
        "laxity.csv",
        "profiles.png",
        "report.html",
        "result.json",
        "result.nc",
        "starts.png",
    }
    summary = summary_in(out)
    assert summary["settings"] == "short settings"
    assert [(x["method"], x["start"]) for x in summary["starts"]] == [
        ("complex", "IG2"),
        ("complex", "IG4"),
        ("least-squares", "IG2"),
        ("least-squares", "IG4"),
    ]
    assert summary["truth"]["ACL"]["stiffness_kN"] == 10.0
    assert len(summary["profiles"]) == 8
    assert "95 % confidence" in result.stdout
    with xarray.open_datatree(out / "result.nc", engine="netcdf4") as tree:
        assert tree["fits"]["theta"].sizes == {"search": 4, "run": 1, "parameter": 8}


@pytest.mark.slow
@pytest.mark.usefixtures("few_trials")
def test_python_tells_the_same_story(tmp_path: Path) -> None:
    assert run("demo", "--runs", "1", "--budget", "60", "--out", tmp_path).exit_code == 0
    assert said(load(tmp_path)) == said(ik.demo(runs=1, budget=60))


@pytest.mark.slow
@pytest.mark.usefixtures("few_trials")
def test_the_number_of_workers_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("identknee.report.write_report.write_report", lambda *_: {})
    # One of the profiles, which are not compared here.
    monkeypatch.setattr(
        "identknee.verbs.demo.profile_parameters",
        lambda problem, theta, **named: profile_parameters(
            problem, theta, problem.parameters.names[:1], **named
        ),
    )
    rows = []
    for workers in ("1", "2"):
        words = ["demo", "--runs", "2", "--budget", "40", "--workers", workers, "--json"]
        result = run(*words, "--out", tmp_path)
        assert result.stderr == ""
        rows.append(json.loads(result.stdout)["starts"])
        for row in rows[-1]:
            row.pop("seconds")
    assert rows[0] == rows[1]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_leaves_a_sentence_and_no_result(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "identknee.cli.main", "demo", "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    assert process.stderr is not None
    said = ""
    while "Fitting" not in said:
        line = process.stderr.readline()
        assert line, said
        said += line
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    # Far shorter than the fits that were under way.
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 130
    # On a busy machine it may still be loading what the fits need.
    assert re.fullmatch("identknee: stopped.*\n", rest)
    assert not (tmp_path / "out" / "result.json").exists()
