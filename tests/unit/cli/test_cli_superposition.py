"""In-situ forces on the command line: a fit with them, its page, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runs import refused, run
from held import both_of, fixing
from replayed_paths import in_situ_forces

import identknee as ik
from identknee.laxity.forces import write_superposition
from identknee.model.laxity_model import LaxityModel

PROTOCOL = ik.load_protocol("table2")
TOML = """
[[experiments]]
name = "tests"
table = "tests.csv"
rig = "robot"
[[experiments]]
name = "insitu"
superposition = "insitu.csv"
rig = "robot"
[rigs.robot]
noise = "0.2mm,0.2deg"
[rigs.robot.uncertainty]
load_cell_N = 3.0
"""
HELD = fixing(both_of("PCL", "LCL", "MCL"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A knee with an ACL of 8 kN: its laxity, and the ACL's force in three replayed paths."""
    model = LaxityModel(knee=ik.reference_knee(), protocol=PROTOCOL)
    theta = model.parameters.vector({"ACL.stiffness_kN": 8.0})
    ik.write_laxity(model.simulate(theta), tmp_path / "tests.csv")
    rows = [(x, "ACL", "intact", "cut: ACL") for x in PROTOCOL.trials[2:5]]
    generator = np.random.default_rng(2)
    made = in_situ_forces(model, theta, rows, pose_sd=(0.05, 0.05), generator=generator)
    write_superposition(made, tmp_path / "insitu.csv")
    (tmp_path / "experiments.toml").write_text(TOML)
    return tmp_path


@pytest.mark.slow
def test_a_fit_has_them_as_a_term_and_draws_them(folder: Path) -> None:
    out = folder / "out"
    words = ("fit", "reference", folder / "experiments.toml", *HELD, "--more-starts", 0)
    result = run(*words, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["parameters"]["ACL"]["stiffness_kN"] == pytest.approx(8.0, abs=0.3)
    assert any("of ACL in 3 replayed paths" in x and "3 N" in x for x in summary["assumptions"])
    terms = {x["name"]: x["n"] for x in summary["evidence"]}
    assert terms["superposition"] == 18
    loaded = ik.load(out)
    assert isinstance(loaded, ik.Calibration)
    assert loaded.data.superposition is not None
    assert loaded.data.superposition.cut == ("ACL",) * 3
    forces = loaded.compared_forces
    assert forces is not None
    assert forces.names[0] == "ACL.force_x_N"
    left = (forces.measured - forces.predicted) / forces.sd
    assert np.abs(left).max() < 4.0
    assert run("report", out).exit_code == 0
    assert "predicted by the fit" in (out / "report.html").read_text()


def test_forces_of_trials_held_out_or_left_out_do_not_count(folder: Path) -> None:
    words = ("fit", "reference", folder / "experiments.toml", *HELD, "--more-starts", 0)
    for i, option in enumerate(("--hold-out", "--leave-out")):
        out = folder / f"out{i}"
        result = run(*words, option, PROTOCOL.trials[3], "--out", out, "--json")
        assert result.exit_code == 0, result.output
        terms = {x["name"]: x["n"] for x in json.loads(result.stdout)["evidence"]}
        assert terms == {
            "laxity table": 5 * (PROTOCOL.n - 1),
            "superposition": 12,
            "priors of nuisance parameters": 3,
        }


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("# reads: load on tibia", "# a robot", "does not say whether the cell reads"),
        ("# reads: load on tibia", "# reads: table", "reaction"),
        ("ACL,intact,cut: ACL", "XYZ,intact,cut: XYZ", "XYZ"),
        (PROTOCOL.trials[2], "none", "no table has this trial"),
        ("cut: ACL", "cut: PCL", "does not follow"),
    ],
)
def test_what_no_table_can_mean_is_one_sentence(
    old: str, new: str, named: str, folder: Path
) -> None:
    path = folder / "insitu.csv"
    path.write_text(path.read_text().replace(old, new))
    words = ("fit", "reference", folder / "experiments.toml", "--out", folder / "out")
    assert named in refused(*words)
