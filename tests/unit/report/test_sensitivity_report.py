"""A sensitivity analysis as a dataset and as figures."""

from pathlib import Path

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure

from identknee.identify.sensitivity.designs import Box
from identknee.identify.sensitivity.estimators import Index
from identknee.identify.sensitivity.sensitivity import FAILURE, Sensitivity
from identknee.laxity.protocol import load_protocol
from identknee.model.parameters import ligament_parameters
from identknee.report.sensitivity_figures import (
    effects_figure,
    map_figure,
    methods_figure,
    shares_figure,
)
from identknee.report.sensitivity_groups import (
    laxity_groups,
    posterior_draws,
    sensitivity_groups,
)

PARAMETERS = ligament_parameters(["A", "new"], [1.0, 2.0], [3.0, 4.0])
GROUPS = ("varus_deg, 0 deg, unloaded", FAILURE)


def index(*, floor: bool = False) -> Index:
    values = np.random.default_rng(0).random((3, 2, 4))
    return Index(
        levels=np.array([2, 4, 8]),
        values=values,
        half_widths=0.1 * values,
        complete=values[-1],
        complete_half_widths=0.2 * values[-1],
        noise_floor=np.array([0.1, 0.2]) if floor else None,
    )


def result(*, is_box: bool) -> Sensitivity:
    return Sensitivity(
        method="sobol" if is_box else "delta",
        parameters=PARAMETERS,
        groups=GROUPS,
        indices={"S1": index(), "ST": index()} if is_box else {"delta": index(floor=True)},
        failed_share=np.array([0.1, 0.2]),
        complete_share=np.array([0.8, 0.7]),
        component_share=np.ones(2),
        n_samples=8,
        n_simulations=48,
        box=Box(lower=np.zeros(4), upper=np.ones(4)) if is_box else None,
        seed=3,
    )


def test_the_dataset_holds_every_index_by_name() -> None:
    found = result(is_box=True)
    data = sensitivity_groups(found)["sensitivity"]
    assert data["ST"].dims == ("group", "parameter")
    assert data["ST_by_level"].dims == ("level", "group", "parameter")
    assert data["n_samples"].values.tolist() == [2, 4, 8]
    one = data["ST"].sel(group=FAILURE, parameter="new.stiffness_kN").item()
    assert one == found.indices["ST"].final[1, 1]
    assert data["upper"].values.tolist() == [1.0] * 4
    assert data.attrs["failures"] == found.rule
    given = sensitivity_groups(result(is_box=False))["sensitivity"]
    assert "lower" not in given
    assert given["delta_noise_floor"].values.tolist() == [0.1, 0.2]


def test_groups_name_coordinate_angle_and_load() -> None:
    protocol = load_protocol("seed63")
    names = laxity_groups(protocol)
    assert len(names) == 5 * protocol.n
    assert len(set(names)) == 5 * 3 * 5
    assert "internal_deg, 30 deg, external moment" in names


def draws_file(folder: Path, group: xarray.Dataset, name: str = "posterior") -> Path:
    folder.mkdir()
    xarray.DataTree.from_dict({name: group}).to_netcdf(folder / "result.nc", engine="h5netcdf")
    return folder


def test_draws_of_a_posterior_are_read_in_the_order_asked_for(tmp_path: Path) -> None:
    values = np.arange(48.0).reshape(2, 3, 4, 2)
    dims = ("ensemble", "walker", "draw", "parameter")
    together = xarray.Dataset({"theta": (dims, values)}, coords={"parameter": ["b", "a"]})
    folder = draws_file(tmp_path / "one", together)
    assert np.array_equal(posterior_draws(folder, ("b", "a"), 100), values.reshape(-1, 2))
    assert np.array_equal(posterior_draws(folder, ("a", "b"), 12)[0], [1.0, 0.0])
    assert len(posterior_draws(folder, ("a", "b"), 12)) == 12
    apart = xarray.Dataset(dict.fromkeys("ab", (("chain", "draw"), values[0, :, :, 0])))
    folder = draws_file(tmp_path / "two", apart)
    assert posterior_draws(folder, ("a", "b"), 100).shape == (12, 2)


def test_what_is_no_posterior_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there are no results to read"):
        posterior_draws(tmp_path / "none", ("a",), 10)
    other = draws_file(tmp_path / "other", xarray.Dataset({"a": ("draw", [1.0])}), "prior")
    with pytest.raises(ValueError, match="there is no posterior in these results"):
        posterior_draws(other, ("a",), 10)
    one = draws_file(tmp_path / "one", xarray.Dataset({"a": ("draw", [1.0])}))
    with pytest.raises(ValueError, match="its posterior is not one of a, b"):
        posterior_draws(one, ("a", "b"), 10)
    theta = xarray.Dataset({"theta": (("draw", "parameter"), np.ones((3, 1)))})
    bare = draws_file(tmp_path / "bare", theta)
    with pytest.raises(ValueError, match="its posterior is not one of a"):
        posterior_draws(bare, ("a",), 10)


def test_figures_are_drawn() -> None:
    values = np.array([0.5, 0.1, 0.0, 0.3])
    names = PARAMETERS.names
    panels = {"one": (values, 0.1 * values, values), "two": (values, values, 2.0 * values)}
    figures = [
        effects_figure(panels, names),
        shares_figure(
            {"one": (values, values, values, values)},
            names,
            (np.array([10.0, 40.0]), np.array([[0.2, 0.4], [0.1, 0.2]])),
        ),
        map_figure(
            {"varus_deg": (["a", "b"], np.array([values, np.full(4, np.nan)]))}, names, "ST"
        ),
        methods_figure({"one": {"delta": (values, values), "pawn": (values, values)}}, names),
    ]
    assert all(isinstance(x, Figure) for x in figures)
    labels = [x.get_text() for x in figures[1].axes[0].get_xticklabels()]
    assert labels == ["A k", "new k", "A eps", "new eps"]
    # The last of an odd number of panels leaves its neighbour empty.
    assert not effects_figure({"one": panels["one"]}, names).axes[1].axison


def test_effects_of_one_trajectory_are_drawn_without_spread() -> None:
    size, unknown = np.array([0.5, 0.1, 0.0, 0.3]), np.full(4, np.nan)
    axes = effects_figure({"one": (size, unknown, unknown)}, PARAMETERS.names).axes[0]
    assert axes.get_xlim() == pytest.approx((0.0, 0.56))
