"""ArviZ compares, checks and draws a sample from its file alone."""

import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
from cli_runs import run, short_protocol
from filelock import FileLock
from held import both_of, fixing
from scipy.stats import multivariate_normal

import identknee as ik

with FileLock(Path(tempfile.gettempdir()) / "identknee-arviz.lock"), warnings.catch_warnings():
    # It warns of its own refactoring, once a day: of two processes that note it at once one fails.
    warnings.simplefilter("ignore")
    az = pytest.importorskip("arviz")

HELD = both_of("PCL", "LCL", "MCL")
# Its file of a sample is the same; names of functions and results differ.
OLD = pytest.mark.skipif("InferenceData" not in vars(az), reason="arviz 1 names them otherwise")


@pytest.fixture(scope="module")
def sampled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arviz")
    protocol = ik.load_protocol(short_protocol(folder))
    laxity = ik.simulate(ik.reference_knee(), protocol).laxity
    noisy = ik.add_noise(laxity, sd_mm=0.3, sd_deg=0.3, seed=1, correlation=0.4)
    coordinates = noisy.coordinates.copy()
    coordinates[2, 1] = np.nan
    sd = np.array(noisy.sd)
    sd[2, 1] = np.nan
    blank = ik.Laxity(
        protocol=protocol, coordinates=coordinates, sd=sd, within_trial_correlation=0.4
    )
    data = ik.write_laxity(blank, folder / "data.csv")
    held = fixing(HELD)
    result = run("sample", "reference", data, *held, "--out", folder, "--budget", 1200)
    assert result.exit_code == 0, result.output
    return folder


@pytest.mark.slow
@OLD
@pytest.mark.filterwarnings("ignore")
def test_leave_one_out_and_pictures_come_from_the_file(sampled: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    data = az.from_netcdf(sampled / "result.nc")
    found = az.loo(data, reff=1.0)
    # Two parameters are free: about as many are effective.
    assert 0.5 < found.p_loo < 4.0
    assert found.n_data_points == 49
    assert az.plot_ppc(data, var_names=["laxity"], num_pp_samples=20) is not None
    names = ["ACL.stiffness_kN", "ACL.reference_strain_pct"]
    axes = az.plot_pair(data, var_names=["theta"], coords={"parameter": names})
    assert axes is not None


def test_the_cells_add_up_to_the_density_of_the_table(sampled: Path) -> None:
    answer = ik.load(sampled)
    assert isinstance(answer, ik.Sample)
    assert answer.cells is not None
    assert answer.predictive is not None
    assert answer.data is not None
    data, cells = answer.data, answer.cells
    assert len(cells.names) == 49
    assert cells.names[0] == f"{data.protocol.trials[0]} lateral_shift_mm"
    np.testing.assert_array_equal(cells.measured.laxity, data.coordinates[data.is_measured])
    expected = 0.0
    for measured, sd, predicted in zip(
        data.coordinates, np.array(data.sd), answer.predictive.coordinates[0, 7], strict=True
    ):
        known = ~np.isnan(measured)
        shared = np.full((known.sum(), known.sum()), 0.4) + 0.6 * np.eye(known.sum())
        covariance = sd[known][:, None] * shared * sd[known]
        expected += multivariate_normal(predicted[known], covariance).logpdf(measured[known])
    assert cells.log_likelihood.laxity[0, 7].sum() == pytest.approx(expected, rel=1e-9)


def test_replicated_laxity_has_the_noise_of_the_data(sampled: Path) -> None:
    answer = ik.load(sampled)
    assert isinstance(answer, ik.Sample)
    assert answer.cells is not None
    assert answer.predictive is not None
    assert answer.data is not None
    clean = answer.predictive.coordinates[0][:, answer.data.is_measured]
    errors = answer.cells.replicated.laxity[0] - clean
    assert errors.std() == pytest.approx(0.3, rel=0.05)
    assert np.corrcoef(errors[:, :2].T)[0, 1] == pytest.approx(0.4, abs=0.25)
