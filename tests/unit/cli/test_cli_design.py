"""`identknee design`, from its words to its files and sentences."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from cli_runs import refused, run, short_protocol, summary_in
from held import both_of, fixing

import identknee as ik
from identknee.laxity.protocol import concatenate
from identknee.subject.knee import BONES
from identknee.verbs.files import load

HELD = fixing(both_of("ACL", "PCL", "MCL"))


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference knee under nine of the 63 trials, 0.5 mm and 0.5 deg."""
    knee, protocol = ik.reference_knee(), ik.load_protocol("seed63").select(range(0, 63, 7))
    laxity = ik.simulate(knee, protocol).laxity
    noisy = ik.add_noise(laxity, sd_mm=0.5, sd_deg=0.5, seed=1)
    return ik.write_laxity(noisy, tmp_path_factory.mktemp("design") / "data.csv")


def test_advice_is_given_verified_and_can_be_appended(noisy: Path, tmp_path: Path) -> None:
    words = ("design", "reference", noisy, *HELD, "--n-trials", 2, "--out", tmp_path)
    result = run(*words, "--candidates", short_protocol(tmp_path), "--target", "LCL.stiffness_kN")
    assert result.exit_code == 0, result.output
    assert "predicted" in result.stdout
    summary = summary_in(tmp_path)
    assert list(summary["before"]) == list(summary["after"]) == ["LCL.stiffness_kN"]
    before, after = (summary[x]["LCL.stiffness_kN"] for x in ("before", "after"))
    before, after = (x["upper"] - x["lower"] for x in (before, after))
    low, high = summary["predicted"]["LCL.stiffness_kN"]
    predicted = high - low
    assert after < before
    assert predicted == pytest.approx(after, rel=0.05)
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        assert {"design", "profile_before", "profile_after"} <= set(tree.children)
        assert tree["design"].dataset.sizes["candidate"] == 10
    advised = ik.read_laxity(tmp_path / "advised_trials.csv")
    assert list(advised.protocol.trials) == summary["advised"]
    assert not advised.is_measured.any()
    answer = load(tmp_path)
    assert isinstance(answer, ik.Design)
    assert answer.to_measure.protocol.trials == advised.protocol.trials
    assert np.array_equal(answer.to_measure.protocol.loads, advised.protocol.loads)
    # Below the measured ones, the rows make one table.
    rows = (tmp_path / "advised_trials.csv").read_text("utf-8").splitlines()
    measured = noisy.read_text("utf-8").splitlines()
    assert rows[1] == measured[0]
    both = tmp_path / "both.csv"
    both.write_text("\n".join([*measured, *rows[2:]]) + "\n", encoding="utf-8")
    assert ik.read_laxity(both).n == 11


@pytest.mark.slow
def test_noise_that_is_not_stated_is_estimated(noisy: Path, tmp_path: Path) -> None:
    laxity = ik.read_laxity(noisy)
    bare = ik.Laxity(protocol=laxity.protocol, coordinates=laxity.coordinates)
    path = ik.write_laxity(bare, tmp_path / "bare.csv")
    words = ("--candidates", short_protocol(tmp_path), "--criterion", "c", "--n-trials", 1)
    result = run("design", "reference", path, *HELD, *words, "--out", tmp_path, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["degrees_of_freedom"] > 0
    assert summary["criterion"] == "c"
    assert any("estimated" in x for x in summary["assumptions"])
    threshold = summary["before"]["LCL.stiffness_kN"]["threshold"]
    assert threshold == pytest.approx(ik.identify.f_threshold(0.95, summary["degrees_of_freedom"]))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--target", "LCL.stifness"), "parameter 'LCL.stifness'"),
        (("--target", "LCL.tension_N@nowhere"), "trial 'nowhere'"),
        (("--candidates", "table3"), "table3"),
    ],
)
def test_wrong_words_are_refused(
    noisy: Path, tmp_path: Path, words: tuple[str, ...], sentence: str
) -> None:
    assert sentence in refused("design", "reference", noisy, *words, "--out", tmp_path)


@pytest.mark.slow
def test_an_insertion_known_better_is_ranked_beside_the_trials(noisy: Path, tmp_path: Path) -> None:
    words = (noisy, *HELD, "--n-trials", 1, "--target", "LCL.stiffness_kN")
    words = (*words, "--candidates", short_protocol(tmp_path))
    result = run("design", "reference", *words, "--uncertain", "insertions=2mm", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert re.search(r"\(.*1 mm .* 2 mm\)", result.stdout)
    summary = summary_in(tmp_path)
    ranking = {x["name"]: x["narrowing"] for x in summary["ranking"]}
    insertions = {
        f"insertion.{x.name}_{bone}" for x in ik.reference_knee().ligaments for bone in BONES
    }
    assert insertions < set(ranking)
    assert max(ranking[x] for x in insertions) > 0.01
    answer = load(tmp_path)
    assert isinstance(answer, ik.Design)
    assert answer.choice.ranking == tuple(summary["ranking"])
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        assert set(tree["design"].dataset["error"].values) == insertions


@pytest.mark.slow
def test_other_steps_are_compared_with_one_more_trial_before_there_are_data(
    tmp_path: Path,
) -> None:
    words = (*HELD, "--n-trials", 1, "--target", "LCL.stiffness_kN", "--noise", "0.5mm,0.5deg")
    words = (*words, "--candidates", short_protocol(tmp_path), "--cost", "cut=4,contact=never")
    shown = run("design", "reference", "--protocol", "table2", *words, "--out", tmp_path)
    assert shown.exit_code == 0, shown.output
    answer = load(tmp_path)
    assert isinstance(answer, ik.Design)
    kinds = {x["kind"] for x in answer.choice.ranking}
    assert {"trial", "cut", "force"} <= kinds
    assert "contact" not in kinds
    assert answer.choice.costs == {"trial": 1.0, "error": 1.0, "cut": 4.0, "force": 1.0}
    for row in answer.choice.ranking:
        cost = answer.choice.costs[row["kind"]]
        assert row["per_cost"] == pytest.approx(1.0 - (1.0 - row["narrowing"]) ** (1.0 / cost))
    assert answer.to_measure.protocol.state is None


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--protocol", "table2"), "--noise"),
        ((), "--protocol"),
        (("--protocol", "table2", "--noise", "1mm,1deg", "--cost", "cuts=1"), "cuts"),
        (("--protocol", "table2", "--noise", "1mm,1deg", "--cost", "cut=-1"), "above 0"),
        (("--protocol", "table2", "--noise", "1mm,1deg", "--cost", "trial=never"), "trial"),
    ],
)
def test_plans_that_say_too_little_are_refused(
    tmp_path: Path, words: tuple[str, ...], sentence: str
) -> None:
    assert sentence in refused("design", "reference", *words, "--out", tmp_path)


@pytest.mark.slow
def test_trials_are_advised_in_the_state_in_which_the_knee_was_left(tmp_path: Path) -> None:
    """Of the data, or of the candidates where these have states of their own."""
    whole = ik.load_protocol("table2").select(range(9))
    cut = replace(
        whole, trials=tuple(f"{x}_cut" for x in whole.trials), state=("cut: MCL",) * whole.n
    )
    made = concatenate([whole, cut], name="made")
    plain = whole.select([2, 4])
    intact = replace(
        plain, trials=tuple(f"{x}_now" for x in plain.trials), state=("intact", "cut: MCL")
    )
    for candidates, states in ((plain, {"cut: MCL"}), (intact, {"intact", "cut: MCL"})):
        answer = ik.design(
            ik.reference_knee(),
            protocol=made,
            candidates=candidates,
            noise="0.5mm,0.5deg",
            targets=["LCL.stiffness_kN"],
            n_trials=2,
            cost="cut=never,force=never,contact=never",
            fixed=[x for x in HELD if x != "--fix"],
        )
        assert set(answer.states) <= states
        assert answer.to_measure.protocol.state == (
            None if set(answer.states) == {"intact"} else answer.states
        )
        for trial, state in zip(answer.trials, answer.states, strict=True):
            assert trial.get("state", "intact") == state
        said, is_cut = str(answer).split("\n", 1)[0], "cut: MCL" in answer.states
        assert ("(cut: MCL)" in said) == is_cut
