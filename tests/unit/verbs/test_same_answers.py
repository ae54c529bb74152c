"""A verb gives the same answer from Python, from the command line, and from its files."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from cli_runs import run, said, short_protocol
from held import fixing
from quick_calls import ALL_BUT_ACL
from slow_cases import some_slow

import identknee as ik
from identknee.report.export import export_subject
from identknee.runs.files import plain
from identknee.runs.schema import summary_of
from identknee.verbs.answer import Answer
from identknee.verbs.files import load

CALLS: Mapping[str, tuple[Callable[..., Answer], Mapping[str, Any]]] = {
    "fit": (ik.fit, {"start": "IG2", "method": "complex", "budget": 40, "seed": 2}),
    "profile": (ik.profile, {"level": 0.9, "budget": 200}),
    "information": (ik.information, {"scaling": "prior"}),
    "sample": (ik.sample, {"moves": "difference", "budget": 700}),
    "sensitivity": (ik.sensitivity, {"method": "morris", "samples": 4}),
    "sweep": (
        ik.sweep,
        {"n_starts": 12, "design": "shells", "distances": "0,1,3", "paths": 4},
    ),
    "design": (ik.design, {"n_trials": 1, "candidates": "drawer", "criterion": "c"}),
    "equivalents": (ik.equivalents, {"n_sets": 4, "forces": "none", "seed": 3}),
}


@pytest.fixture(scope="module")
def laxity(tmp_path_factory: pytest.TempPathFactory) -> ik.Laxity:
    """The reference knee under ten trials, with noise."""
    folder = tmp_path_factory.mktemp("same")
    knee, protocol = ik.reference_knee(), ik.load_protocol(short_protocol(folder))
    return ik.add_noise(ik.simulate(knee, protocol).laxity, sd_mm=0.3, sd_deg=0.3, seed=1)


@pytest.mark.parametrize(
    "verb", some_slow(CALLS, ("sample", "design", "equivalents", "sweep", "information"))
)
def test_python_and_command_line_agree(verb: str, laxity: ik.Laxity, tmp_path: Path) -> None:
    function, options = CALLS[verb]
    data = ik.write_laxity(laxity, tmp_path / "data.csv")
    made = function(ik.reference_knee(), ik.read_laxity(data), fixed=ALL_BUT_ACL, **options)
    words = [y for name, x in options.items() for y in (f"--{name.replace('_', '-')}", x)]
    held = fixing(ALL_BUT_ACL)
    result = run(verb, "reference", data, *held, *words, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert said(load(tmp_path / "out")) == said(made)


def test_a_simulation_is_the_same_from_both(tmp_path: Path) -> None:
    options: dict[str, Any] = {
        "start": "IG2",
        "noise": "0.3mm,0.4deg",
        "seed": 3,
        "noise_correlation": 0.2,
    }
    made = ik.simulate(ik.reference_knee(), "drawer", {"ACL.stiffness_kN": 9.5}, **options)
    words = [y for name, x in options.items() for y in (f"--{name.replace('_', '-')}", x)]
    setting = ("--protocol", "drawer", "--set", "ACL.stiffness_kN=9.5")
    result = run("simulate", "reference", *setting, *words, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert said(load(tmp_path)) == said(made)


@pytest.mark.parametrize(
    ("verb", "function", "options"),
    [
        ("check", ik.verbs.check_subject, {"protocol": "drawer", "samples": 3, "seed": 2}),
        ("settle", ik.verbs.settle_subject, {"protocol": "drawer", "within": 2.0}),
        ("show", ik.verbs.describe_subject, {}),
    ],
)
def test_what_is_said_of_a_subject_is_the_same_from_both(
    verb: str, function: Callable[..., Answer], options: Mapping[str, Any], tmp_path: Path
) -> None:
    made = function(ik.reference_knee(), **options)
    words = [y for name, x in options.items() for y in (f"--{name}", x)]
    result = run("subject", verb, "reference", *words, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert said(load(tmp_path)) == said(made)
    assert str(made) in result.stdout


def test_an_exported_knee_is_the_same_from_both(tmp_path: Path) -> None:
    made = export_subject(ik.reference_knee(), osim=True, out=tmp_path / "python")
    result = run("subject", "export", "reference", "--osim", "--out", tmp_path / "typed")
    assert result.exit_code == 0, result.output
    assert said(load(tmp_path / "typed")) == said(made).replace("python", "typed")
    assert (tmp_path / "typed" / "reference.osim").is_file()


def test_an_imported_knee_is_the_same_from_both(tmp_path: Path) -> None:
    made = ik.verbs.import_subject("lenhart2015", bundles="merged")
    result = run("subject", "import-osim", "lenhart2015", "--bundles", "merged", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert said(load(tmp_path)) == said(made)
    listed = {x.name for x in ik.verbs.list_subjects().subjects}
    assert {
        x["name"] for x in json.loads(run("subject", "list", "--json").stdout)["subjects"]
    } == listed


def test_the_named_subjects_are_the_same_from_both() -> None:
    made = ik.verbs.list_subjects()
    assert json.loads(run("subject", "list", "--json").stdout) == plain(summary_of(made))
    assert str(made) in run("subject", "list").stdout
