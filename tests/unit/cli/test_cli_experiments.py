"""Several tables of one knee on the command line, and what is wrong with some."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runs import refused, run
from held import both_of, fixing

import identknee as ik
from identknee.laxity.experiment_tables import read_experiments

PROTOCOL = ik.load_protocol("table2")
HELD = fixing(both_of("PCL", "LCL", "MCL"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Tables of a knee intact and without its MCL, an ACL of 8 kN, and of two other kinds."""
    for i, (name, state) in enumerate({"intact": "intact", "cut": "cut: MCL"}.items()):
        protocol = replace(PROTOCOL, name=name, state=(state,) * PROTOCOL.n)
        model = ik.LaxityModel(knee=ik.reference_knee(), protocol=protocol)
        theta = model.parameters.vector({"ACL.stiffness_kN": 8.0})
        made = ik.add_noise(model.simulate(theta), sd_mm=0.2, sd_deg=0.2, seed=i)
        ik.write_laxity(made, tmp_path / f"{name}.csv")
    text = (tmp_path / "cut.csv").read_text()
    (tmp_path / "wrong.csv").write_text(text.replace("cut: MCL", "cut: XYZ"))
    (tmp_path / "all.csv").write_text(text.replace("cut: MCL", '"cut: ACL, PCL, LCL, MCL"'))
    header, *rows = text.splitlines()
    forces = [f"{header},MCL_tension_N,sd_MCL_tension_N", *(f"{x},10,5" for x in rows)]
    (tmp_path / "force.csv").write_text("\n".join(forces))
    (tmp_path / "severed.csv").write_text(text.replace("cut: MCL", "severed"))
    return tmp_path


def test_two_tables_are_fitted_together(folder: Path) -> None:
    out = folder / "out"
    tables = (folder / "intact.csv", folder / "cut.csv")
    words = ("fit", "reference", *tables, *HELD, "--noise", "0.2mm,0.2deg", "--more-starts", 0)
    result = run(*words, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["parameters"]["ACL"]["stiffness_kN"] == pytest.approx(8.0, abs=0.4)
    assert len(summary["trials_used"]) == 2 * PROTOCOL.n
    assert summary["trials_used"][0].startswith("intact/")
    assert any("2 experiments" in x and "1 mounting" in x for x in summary["assumptions"])
    loaded = ik.load(out)
    assert isinstance(loaded, ik.Calibration)
    assert loaded.data.protocol.state is not None
    assert set(loaded.data.protocol.state) == {"intact", "cut: MCL"}
    assert [x.name for x in loaded.data.protocol.experiments] == ["intact", "cut"]
    same = ik.fit("reference", [str(x) for x in tables], fixed=HELD[1::2], noise=0.2, more_starts=0)
    np.testing.assert_array_equal(same.search.theta, loaded.search.theta)


def test_tables_of_one_name_are_named_after_their_folders(folder: Path) -> None:
    (folder / "later").mkdir()
    (folder / "later" / "intact.csv").write_bytes((folder / "cut.csv").read_bytes())
    read = read_experiments([folder / "intact.csv", folder / "later" / "intact.csv"])
    assert [x.name for x in read.protocol.experiments] == [folder.name, "later"]


@pytest.mark.parametrize(
    ("tables", "named"),
    [
        (("wrong.csv",), "XYZ"),
        (("all.csv",), "every ligament"),
        (("severed.csv",), "severed"),
        (("force.csv",), "the force of MCL"),
        (("intact.csv", "intact.csv"), "two tables are called "),
        (("intact.csv", "none.csv"), "none.csv"),
        (("intact.csv", "reference"), "subject"),
    ],
)
def test_wrong_tables_are_refused(tables: tuple[str, ...], named: str, folder: Path) -> None:
    paths = [folder / x if x.endswith(".csv") else x for x in tables]
    assert named in refused("fit", "reference", *paths, "--out", folder / "out")
