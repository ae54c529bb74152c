"""`identknee equivalents`, from its words to its files and sentences."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from cli_runs import refused, run, short_protocol
from held import fixing

import identknee as ik
from identknee.verbs.files import load

VERB = ("equivalents", "reference")
HELD = fixing(f"{name}.stiffness_kN" for name in ("PCL", "LCL", "MCL"))


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Noisy laxity of the reference knee in a few trials."""
    folder = tmp_path_factory.mktemp("data")
    protocol = ik.load_protocol(short_protocol(folder))
    laxity = ik.simulate(ik.reference_knee(), protocol).laxity
    noisy = ik.add_noise(laxity, sd_mm=0.1, sd_deg=0.1, seed=2)
    return ik.write_laxity(noisy, folder / "data.csv")


def test_sets_and_what_they_leave_open(table: Path, tmp_path: Path) -> None:
    words = (*VERB, table, "--n-sets", 12, *HELD, "--forces", "largest", "--out", tmp_path)
    result = run(*words, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["criterion"] == "noise"
    assert summary["power_of_best_test"] == pytest.approx(0.26, abs=0.01)
    assert summary["n_sets"] == 12
    assert summary["farthest"] >= 0.9 * summary["diameter"]
    assert summary["closest"] >= 0.02 * summary["diameter"]
    assert summary["largest_distance"] <= 1.0 + 1e-6
    assert summary["n_simulations"] > 100
    assert list(summary["parameters"]) == [
        "ACL.stiffness_kN",
        *(f"{x}.reference_strain_pct" for x in ("ACL", "PCL", "LCL", "MCL")),
    ]
    assert len(summary["quantities"]) == 4 * 10
    for x in (*summary["parameters"].values(), *summary["quantities"].values()):
        assert x["lower"] <= x["fit"] <= x["upper"]
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        data = tree["equivalent_sets"].dataset
        assert data["theta"].shape == (12, 5)
        assert data["tension_N"].shape == (12, 10, 4)
        assert tree["quantity_ranges"]["upper_side_theta"].shape == (40, 5)
        model = ik.LaxityModel(knee=ik.reference_knee(), protocol=ik.read_laxity(table).protocol)
        theta = np.array(model.parameters.center)
        theta[[0, 4, 5, 6, 7]] = data["theta"].values[3]
        assert np.array_equal(model.simulate(theta).coordinates, data["coordinates"].values[3])
    told = str(load(tmp_path))
    for part in ("Among 12 ", "26 of 100 ", "12 of 40 "):
        assert part in told


def test_predictions_of_any_kind_have_ranges(table: Path, tmp_path: Path) -> None:
    trial = "flexion30_varus4Nm"
    names = [f"contact.medial_N@{trial}", f"MCL.strain_pct@{trial}", f"varus_deg@{trial}"]
    asked = [x for name in names for x in ("--quantity", name)]
    words = (*VERB, table, "--n-sets", 3, *HELD, "--forces", "none", *asked)
    result = run(*words, "--out", tmp_path, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)["quantities"]
    assert list(found) == names
    for x in found.values():
        assert x["lower"] < x["fit"] < x["upper"]
    # The MCL is slack under a varus moment.
    assert found[names[1]]["upper"] < 0.0 < found[names[0]]["lower"]


def test_the_paper_s_criterion(table: Path, tmp_path: Path) -> None:
    words = ("--criterion", "paper", "--limit", "0.01", "--n-sets", 5, "--forces", "none")
    result = run(*VERB, table, *words, *HELD, "--out", tmp_path, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["power_of_best_test"] is None
    answer = load(tmp_path)
    assert isinstance(answer, ik.Equivalents)
    assert "internal_deg@30" in answer.region.blocks
    assert len(answer.region.blocks) == 6
    assert answer.region.quantities == {}
    assert answer.region.largest_distance <= 0.01 * (1 + 1e-6)


def test_what_cannot_be_asked_is_said(table: Path, tmp_path: Path) -> None:
    said = refused(*VERB, table, "--limit", "0", "--out", tmp_path)
    assert "than 0" in said
    with pytest.raises(ValueError, match=r"criterion papers: .*noise, paper"):
        ik.equivalents("reference", table, criterion="papers")  # type: ignore[arg-type]
