"""Draws of a posterior are read from files, and what is none is refused."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from identknee.runs.errors import InputError
from identknee.verbs.sensitivity import posterior_draws

STORED = Path(__file__).parents[2] / "fuzz" / "results" / "sample" / "result.nc"


def draws_file(folder: Path, group: xarray.Dataset, name: str = "posterior") -> Path:
    folder.mkdir()
    xarray.DataTree.from_dict({name: group}).to_netcdf(folder / "result.nc", engine="netcdf4")
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
    with pytest.raises(ValueError, match=r"none.*results"):
        posterior_draws(tmp_path / "none", ("a",), 10)
    other = draws_file(tmp_path / "other", xarray.Dataset({"a": ("draw", [1.0])}), "prior")
    with pytest.raises(ValueError, match="no posterior"):
        posterior_draws(other, ("a",), 10)
    one = draws_file(tmp_path / "one", xarray.Dataset({"a": ("draw", [1.0])}))
    with pytest.raises(ValueError, match="one of a, b"):
        posterior_draws(one, ("a", "b"), 10)
    theta = xarray.Dataset({"theta": (("draw", "parameter"), np.ones((3, 1)))})
    bare = draws_file(tmp_path / "bare", theta)
    with pytest.raises(ValueError, match="one of a"):
        posterior_draws(bare, ("a",), 10)


def test_a_damaged_file_is_refused_or_read(tmp_path: Path) -> None:
    with xarray.open_datatree(STORED, engine="netcdf4") as tree:
        names = tuple(str(x) for x in tree["posterior"].dataset["parameter"].values)
    content = STORED.read_bytes()
    generator, refused = np.random.default_rng(1), 0
    for k in range(30):
        damaged = np.frombuffer(content, np.uint8).copy()
        n = (1, 20, 200)[k % 3]
        damaged[generator.integers(len(content), size=n)] = generator.integers(256, size=n)
        # In a folder of its own: the library may still hold the last one.
        folder = tmp_path / f"{k}"
        folder.mkdir()
        (folder / "result.nc").write_bytes(damaged.tobytes())
        try:
            posterior_draws(folder, names, 10)
        except InputError:
            refused += 1
    assert 5 <= refused < 30
