"""`identknee diagnose`, from its words to its files and sentences."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import xarray
from cli_runs import refused, run, said, short_protocol, summary_in
from diagnoses import FRAME, FRAME_DEG, short_data
from posed_knees import posed_folder

import identknee as ik
from identknee.diagnosis.isolability import MOST_TRIALS
from identknee.model.effects.facts import cause_label
from identknee.model.effects.library import library
from identknee.runs.files import plain
from identknee.runs.schema import summary_of

# Two groups of these pass for each other where there are few trials.
FEW = {FRAME, "tibia_frame", "posteromedial", "posterior_capsule", "deep_mcl"}
PICTURES = {"misfit", "residuals", "added_variable", "scores", "parameters", "missing_wrench"}


@pytest.fixture(scope="module")
def framed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, str]:
    """Data with a turned femoral frame, the folder of their diagnosis, and what it printed."""
    folder = tmp_path_factory.mktemp("framed")
    data = ik.write_laxity(short_data(ik.reference_knee(), FRAME), folder / "data.csv")
    result = run("diagnose", "reference", data, "--start", "IG2", "--out", folder / "out")
    assert result.exit_code == 0, result.output
    return data, folder / "out", result.stdout


def test_the_keys_that_checks_read_are_there(framed: tuple[Path, Path, str]) -> None:
    _, out, printed = framed
    summary = summary_in(out)
    assert summary["verdict"] == "NAMED"
    (cause,) = summary["causes"]
    assert cause["name"] == FRAME
    assert cause["unit"] == "deg"
    assert cause["ci95"][0] < FRAME_DEG < cause["ci95"][1]
    assert summary["group"] == [FRAME]
    assert summary["advised_trials"] == []
    gain = summary["gain"]
    assert gain["rmse_held_out_after"] < gain["rmse_held_out_before"]
    assert gain["elpd_difference"] > 2 * gain["elpd_se"]
    for tree in (summary["parameters_before"], summary["parameters_after"]):
        assert list(tree) == ["ACL", "PCL", "LCL", "MCL"]
        assert all(isinstance(x["stiffness_kN"], float) for x in tree.values())
    assert summary["record"]["seed"] == 0
    assert cause_label(FRAME) in printed
    assert "Verdict: NAMED" in printed


def test_arrays_and_pictures_are_left_beside(framed: tuple[Path, Path, str]) -> None:
    data, out, _ = framed
    n = ik.read_laxity(data).n
    with xarray.open_datatree(out / "result.nc", engine="netcdf4") as tree:
        assert tree["residuals"]["before"].shape == (n, 5)
        assert {"misfit", "scores", "refits", "observed_data"} <= set(tree.children)
        wrench = tree["missing_wrench"]["outside"]
        assert wrench.shape == (n, 5)
        assert wrench["component"].to_numpy().tolist()[1:3] == ["internal_Nm", "x_N"]
        explanations = tree["refits"]["explanation"].to_numpy().tolist()
        assert explanations[:2] == ["none", FRAME]
    assert {x.stem for x in out.glob("*.png")} == PICTURES


@pytest.mark.slow
def test_python_gives_the_same_answer(framed: tuple[Path, Path, str]) -> None:
    data, out, _ = framed
    answer = ik.diagnose(ik.reference_knee(), ik.read_laxity(data), start="IG2")
    stored = summary_in(out)
    said = plain(summary_of(answer))
    assert set(said) == set(stored)
    for key in set(stored) - {"seconds", "record"}:
        assert said[key] == stored[key], key


def test_other_verbs_go_on_with_the_extended_subject(
    framed: tuple[Path, Path, str], tmp_path: Path
) -> None:
    data, out, _ = framed
    start = out / "extended" / "fitted.toml"
    words = ("fit", out / "extended", data, "--start", start, "--priors", "--out", tmp_path)
    result = run(*words, "--weighting", "noise")
    assert result.exit_code == 0, result.output
    found, before = summary_in(tmp_path)["parameters"], summary_in(out)
    for ligament, own in before["parameters_after"].items():
        for name, value in own.items():
            low, high = before["parameters_after_ci95"][ligament][name]
            # The same fit but for the roughness of the surfaces, which counts as noise here.
            assert found[ligament][name] == pytest.approx(value, abs=0.25 * (high - low))


@pytest.mark.slow
def test_a_knee_of_another_side_place_and_names(tmp_path: Path) -> None:
    subject = posed_folder(tmp_path / "subject", 1)
    data = short_data(ik.read_subject(subject), None)
    path = ik.write_laxity(data, tmp_path / "data.csv")
    result = run("diagnose", subject, path, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    summary = summary_in(tmp_path / "out")
    # Curves this short do not show their noise, and a verdict may hang on what is stated of it.
    assert summary["verdict"] in {"ADEQUATE", "NOT_TESTABLE"}
    assert summary["causes"] == []
    assert summary["gain"] is None
    assert summary["parameters_after"] == summary["parameters_before"]
    assert {x["cell"] for x in summary["effects"].values()} == {"excluded", "inconclusive"}


def test_without_known_noise_nothing_can_be_said(tmp_path: Path) -> None:
    silent = replace(short_data(ik.reference_knee(), None), sd=None)
    path = ik.write_laxity(silent, tmp_path / "data.csv")
    result = run("diagnose", "reference", path, "--out", tmp_path / "out", "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["verdict"] == "NOT_TESTABLE"
    assert "--noise" in summary["reasons"][0]
    assert summary["causes"] == []


@pytest.mark.slow
def test_trials_say_what_they_could_tell_before_any_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The fewer effects, the fewer pairs for which trials are searched.
    effects = [x for x in library(ik.reference_knee()) if x.name in FEW]
    monkeypatch.setattr("identknee.diagnosis.advice.library", lambda _: effects)
    protocol = short_protocol(tmp_path)
    words = ("--protocol", protocol, "--noise", "0.3mm,0.3deg", "--out", tmp_path)
    result = run("diagnose", "reference", *words)
    assert result.exit_code == 0, result.output
    made = ik.diagnose(ik.reference_knee(), protocol=protocol, noise="0.3mm,0.3deg")
    assert said(ik.load(tmp_path)) == said(made)
    summary = summary_in(tmp_path)
    assert summary["effects"][FRAME]["detectable"] > 0
    assert len(summary["groups"]) == 2
    for group in summary["groups"]:
        assert len(group["effects"]) > 1
        assert 0 < len(group["advised_trials"]) <= MOST_TRIALS
        assert group["distance_with_advised_trials"] > group["distance"]
    assert (tmp_path / "isolability.png").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "DATA.csv or --protocol"),
        (("--protocol", "seed63"), "needs --noise"),
        (("--protocol", "seed63", "--noise", "0mm,1deg"), "more than 0"),
        (("--protocol", "seed64", "--noise", "1mm,1deg"), "seed64"),
    ],
)
def test_wrong_words_are_refused(tmp_path: Path, words: tuple[str, ...], sentence: str) -> None:
    assert sentence in refused("diagnose", "reference", *words, "--out", tmp_path)


def test_wrong_words_about_data_are_refused(framed: tuple[Path, Path, str], tmp_path: Path) -> None:
    data = framed[0]

    def refusal(*words: str) -> str:
        return refused("diagnose", "reference", data, *words, "--out", tmp_path)

    assert "DATA.csv or --protocol" in refusal("--protocol", "seed63")
    assert "start 'IG5'" in refusal("--start", "IG5")
    assert "--noise 0.3:" in refusal("--noise", "0.3")


def test_limits_that_cannot_count_are_refused_before_the_diagnosis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("identknee.verbs.diagnose.investigate")
    data = ik.write_laxity(short_data(ik.reference_knee(), FRAME), tmp_path / "data.csv")
    limits = tmp_path / "limits.toml"
    limits.write_text(
        '[[plausibility]]\nquantity = "XYZ.tension_N"\nstrength = { mean = 600.0, sd = 10.0 }\n'
    )
    asked = "diagnose", "reference", data, "--plausible", limits, "--out", tmp_path / "out"
    assert "XYZ" in refused(*asked)
    planned = "diagnose", "reference", "--protocol", "table2", "--noise", "0.3mm,0.3deg"
    assert "--protocol" in refused(*planned, "--plausible", "default")
