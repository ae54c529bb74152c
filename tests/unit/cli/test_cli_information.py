"""`identknee information`, from its words to its files and sentences."""

from pathlib import Path

import pytest
import xarray
from cli_runs import refused, run, summary_in

import identknee as ik

HELD = ("--fix", "PCL.stiffness_kN", "--fix", "PCL.reference_strain_pct")


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference knee under nine of the 63 trials, 0.5 mm and 0.5 deg."""
    knee, protocol = ik.reference_knee(), ik.load_protocol("seed63").select(range(0, 63, 7))
    laxity = ik.simulate(knee, protocol).laxity
    noisy = ik.add_noise(laxity, sd_mm=0.5, sd_deg=0.5, seed=1)
    return ik.write_laxity(noisy, tmp_path_factory.mktemp("information") / "data.csv")


def test_what_is_known_is_said_in_words_and_files(noisy: Path, tmp_path: Path) -> None:
    words = ("information", "reference", noisy, *HELD, "--scaling", "prior", "--out", tmp_path)
    result = run(*words)
    assert result.exit_code == 0, result.output
    summary = summary_in(tmp_path)
    assert summary["scaling"] == "prior"
    assert summary["n_above_noise"] == 6
    assert "PCL.stiffness_kN" not in summary["sd"]
    values = [x["value"] for x in summary["eigenvalues"]]
    assert values == sorted(values, reverse=True)
    assert len(summary["collinear"]) == 6
    assert summary["structure"]["verdict"] == "full_rank"
    assert summary["n_simulations"] > summary["structure"]["n_points"]
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        assert set(tree.children) == {"fisher", "structure", "geodesics"}


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    none = tmp_path / "none.csv"
    assert refused("information", "reference", none, "--out", tmp_path).startswith(f"{none}: ")


def test_a_scaling_that_is_none_is_refused(noisy: Path) -> None:
    with pytest.raises(ValueError, match=r"scaling steps: .* typical, prior"):
        ik.information("reference", noisy, scaling="steps")  # type: ignore[arg-type]
