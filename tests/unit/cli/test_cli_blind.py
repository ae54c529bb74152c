"""`identknee blind` and `identknee reveal`, from their words to their files and sentences."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import refused, run, said
from diagnoses import FRAME, answered
from report_folders import write_given

import identknee as ik
from identknee.diagnosis.verdict import Verdict
from identknee.runs.files import plain
from identknee.runs.schema import summary_of
from identknee.verbs.files import load

OPTIONS: dict[str, Any] = {"seed": 7, "effect": "rig_compliance_IE", "signal": 8}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("blind")
    words = [y for name, x in OPTIONS.items() for y in (f"--{name}", x)]
    result = run("blind", *words, "--out", out)
    assert result.exit_code == 0, result.output
    assert result.stderr == "", "a signal that is reached needs no word"
    assert "63 trials" in result.stdout
    return out


def _diagnosis(folder: Path, verdict: str, *causes: str) -> Path:
    """A folder that `diagnose` might have left."""
    made = answered(FRAME)
    named = [replace(made.causes[0], name=x, line=None) for x in causes]
    answer = replace(made, verdict=Verdict(verdict), causes=tuple(named), line=None)
    return write_given(folder, "diagnose", answer)


def test_the_folder_gives_nothing_away(folder: Path) -> None:
    laxity = ik.read_laxity(folder / "laxity.csv")
    assert laxity.n == 63
    assert laxity.sd is not None
    for path in folder.iterdir():
        assert b"compliance" not in path.read_bytes()


def test_the_truth_is_revealed_and_a_right_name_scored(folder: Path, tmp_path: Path) -> None:
    diagnosis = _diagnosis(tmp_path, "NAMED", "rig_compliance_IE")
    result = run("reveal", folder, diagnosis)
    assert result.exit_code == 0, result.output
    assert "rig_compliance_IE" in result.stdout
    summary = json.loads(run("reveal", folder, diagnosis, "--json").stdout)
    assert summary["correct"] is True
    assert summary["wrong"] is False
    assert summary["truth"]["effects"] == ["rig_compliance_IE"]


def test_a_wrong_name_is_wrong(folder: Path, tmp_path: Path) -> None:
    diagnosis = _diagnosis(tmp_path, "NAMED", "meniscus")
    summary = json.loads(run("reveal", folder, diagnosis, "--json").stdout)
    assert summary["wrong"] is True
    assert summary["correct"] is False


def test_mistakes_end_in_a_sentence(folder: Path, tmp_path: Path) -> None:
    assert "menicus" in refused("blind", "--effect", "menicus", "--out", tmp_path)
    assert "truth.json" in refused("reveal", tmp_path / "none", tmp_path)
    (tmp_path / "result.json").write_text("{}", encoding="utf-8")
    assert "no verb" in refused("reveal", folder, tmp_path)


@pytest.mark.slow
def test_a_signal_that_is_not_reached_is_said(tmp_path: Path) -> None:
    words = ["blind", "--effect", "toe_strain", "--signal", 20, "--seed", 1, "--out", tmp_path]
    result = run(*words)
    assert result.exit_code == 0, result.output
    truth = ik.blind.read_truth(tmp_path)
    assert truth.is_largest
    assert truth.signal < 10.0
    assert f"toe_strain is {truth.signal:.2g}, not 20" in result.stderr
    told = run("reveal", tmp_path, _diagnosis(tmp_path, "ADEQUATE")).stdout
    assert "signal of 20" in told
    assert f" {truth.signal:.2g}." in told


def test_what_a_random_case_says_of_its_signal_tells_nothing(tmp_path: Path) -> None:
    # Of these two seeds one hides nothing and the other an effect of the signal asked for.
    said = []
    for seed in (20, 6):
        result = run("blind", "--signal", 6, "--seed", seed, "--out", tmp_path / str(seed))
        said.append(result.stderr)
    truths = [ik.blind.read_truth(tmp_path / str(seed)) for seed in (20, 6)]
    assert sorted(bool(x.effects) for x in truths) == [False, True]
    assert said[0] == said[1]
    assert "less than 6" in said[0]


@pytest.mark.slow
def test_python_gives_the_same_data_and_reveals_the_same(folder: Path, tmp_path: Path) -> None:
    made = ik.blind_test.make_blind(**OPTIONS)
    assert said(load(folder)) == said(made)
    assert made.case is not None
    again = ik.write_laxity(made.case.laxity, tmp_path / "again.csv")
    assert (folder / "laxity.csv").read_bytes() == again.read_bytes()
    diagnosis = answered(FRAME)
    left = write_given(tmp_path / "diagnosis", "diagnose", diagnosis)
    revealed = ik.blind_test.reveal(made, diagnosis)
    assert "asked for" not in str(revealed)
    assert run("reveal", folder, left).stdout.strip() == str(revealed)
    printed = json.loads(run("reveal", folder, left, "--json").stdout)
    assert printed == plain(summary_of(revealed))


@pytest.mark.slow
def test_a_knee_is_given_as_wrong_as_stated_and_the_errors_are_revealed(tmp_path: Path) -> None:
    words = ["--effect", "none", "--seed", 3, "--uncertain", "insertions=2mm,load_gain=3%"]
    result = run("blind", *words, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    errors = ik.blind.read_truth(tmp_path).stated_errors
    acl = np.array([errors[f"insertion.ACL_femur_{axis}_mm"] for axis in "xyz"])
    told = run("reveal", tmp_path, _diagnosis(tmp_path, "ADEQUATE")).stdout
    assert f"insertion.ACL_femur {np.linalg.norm(acl):.2g} mm" in told
    assert f"varus moment {100.0 * errors['load_gain.varus_moment']:+.2g} %" in told
    assert "surface_mm" in refused("blind", "--uncertain", "surface=1mm", "--out", tmp_path)
