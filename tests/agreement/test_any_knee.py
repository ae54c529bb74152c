"""Every verb on a knee with other names, another side, place and size, and a fifth ligament."""

import json
from pathlib import Path

import pytest
from posed_knees import FIFTH, NAMES, posed_folder
from typer.testing import CliRunner, Result

from identknee.cli.app import app

# The start is off in two values; least squares finds them again to the solver's own accuracy.
RECOVERY = 1e-6
PROTOCOL = """
format = 1
[[ramps]]
flexion_deg = [0, 30]
load = "internal_moment_Nm"
values = [-6, -3, 0, 3, 6]
[[ramps]]
flexion_deg = [0, 30]
load = "varus_moment_Nm"
values = [-6, -3, 3, 6]
"""


def _run(*words: object) -> Result:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return posed_folder(tmp_path_factory.mktemp("posed") / "subject", seed=3)


@pytest.mark.usefixtures("few_starts")
def test_simulated_laxity_is_fitted_back_to_the_parameters(subject: Path, tmp_path: Path) -> None:
    protocol, start = tmp_path / "short.toml", tmp_path / "start.toml"
    protocol.write_text(PROTOCOL, encoding="utf-8")
    start.write_text(
        f"[{NAMES[0]}]\nstiffness_kN = 9.0\n[{FIFTH.name}]\nreference_strain_pct = -1.0\n",
        encoding="utf-8",
    )
    _run("simulate", subject, "--protocol", protocol, "--out", tmp_path / "data")
    outcomes = json.loads((tmp_path / "data" / "result.json").read_text())["trials"]
    assert {trial["outcome"] for trial in outcomes} == {"converged"}

    data = tmp_path / "data" / "laxity.csv"
    _run("fit", subject, data, "--start", start, "--out", tmp_path / "fit")
    found = json.loads((tmp_path / "fit" / "result.json").read_text())
    assert found["outcome"] == "minimum"
    assert set(found["parameters"]) == {*NAMES, FIFTH.name}
    assert found["parameters"][NAMES[0]]["stiffness_kN"] == pytest.approx(10.0, abs=RECOVERY)
    fifth = found["parameters"][FIFTH.name]["reference_strain_pct"]
    assert fifth == pytest.approx(FIFTH.reference_strain_pct, abs=RECOVERY)


def test_the_subject_is_checked_shown_and_exported(subject: Path, tmp_path: Path) -> None:
    # No --protocol: the margin is looked at over seed63, as a user would.
    _run("subject", "check", subject, "--samples", 3, "--out", tmp_path / "check")
    _run("subject", "show", subject, "--out", tmp_path / "show")
    assert list((tmp_path / "show").glob("*.png"))
    _run("subject", "export", subject, "--out", tmp_path / "export")
    assert list((tmp_path / "export").rglob("subject.toml"))
