"""The two files every verb leaves."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray

from identknee.report.result_files import write_result
from identknee.runs.errors import InputError
from identknee.runs.record import Record, record


def a_record() -> Record:
    return record("fit", {"method": "complex"}, {"data": "0" * 64}, seed=3).finish()


def a_group() -> xarray.Dataset:
    return xarray.Dataset({"x": ("trial", np.array([1.5, np.nan]))}, coords={"trial": ["a", "b"]})


def test_both_files_hold_what_was_given(tmp_path: Path) -> None:
    summary = write_result(
        tmp_path, {"rmse": {"mm": 0.1 + 0.2}, "objective": np.inf}, {"g": a_group()}, a_record()
    )
    read = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert read["rmse"] == {"mm": 0.1 + 0.2}
    assert read["objective"] is None
    assert read["record"] == summary["record"]
    assert read["record"]["seed"] == 3
    with xarray.open_datatree(tmp_path / "result.nc", engine="h5netcdf") as tree:
        np.testing.assert_array_equal(tree["g"]["x"], [1.5, np.nan])
        assert tree["g"].dataset["trial"].to_numpy().tolist() == ["a", "b"]
        assert tree.attrs["verb"] == "fit"


def test_nothing_else_is_left_in_the_folder(tmp_path: Path) -> None:
    for _ in range(2):
        write_result(tmp_path, {}, {"g": a_group()}, a_record())
    assert sorted(x.name for x in tmp_path.iterdir()) == ["result.json", "result.nc"]


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"result\.nc: it cannot be written"):
        write_result(tmp_path / "none", {}, {"g": a_group()}, a_record())


def test_a_summary_without_json_form_leaves_the_old_one(tmp_path: Path) -> None:
    write_result(tmp_path, {"a": 1}, {"g": a_group()}, a_record())
    with pytest.raises(TypeError):
        write_result(tmp_path, {"a": object()}, {"g": a_group()}, a_record())
    assert json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["a"] == 1
