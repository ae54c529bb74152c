"""The two files every verb leaves."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from report_folders import KNEE, OPEN_BELOW, straight_profiles

from identknee.runs.errors import InputError
from identknee.runs.files import digest
from identknee.runs.record import record
from identknee.verbs.files import write_answer
from identknee.verbs.profile import Profiles


def an_answer() -> Profiles:
    """One with an open end, which is no number."""
    made = record("profile", {"level": 0.9}, {"subject": KNEE}, seed=3).finish()
    return replace(straight_profiles(), record=made)


def test_both_files_hold_what_was_given(tmp_path: Path) -> None:
    given = an_answer()
    written = write_answer(tmp_path, given)
    read = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert read["deviance"] == given.deviance
    assert given.parameters[OPEN_BELOW].lower is None
    assert read["parameters"][OPEN_BELOW]["lower"] is None
    assert written.record is not None
    assert read["record"] == {**written.record.to_dict(), "arrays": digest(tmp_path / "result.nc")}
    assert read["record"]["seed"] == 3
    with xarray.open_datatree(tmp_path / "result.nc", engine="netcdf4") as tree:
        assert tree.attrs["verb"] == "profile"
        np.testing.assert_array_equal(tree["result"]["theta"], given.optimum)


def test_nothing_else_is_left_in_the_folder(tmp_path: Path) -> None:
    for _ in range(2):
        write_answer(tmp_path, an_answer())
    assert sorted(x.name for x in tmp_path.iterdir()) == ["result.json", "result.nc"]


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"result\.nc.*written"):
        write_answer(tmp_path / "none", an_answer())


def test_what_no_verb_gave_back_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a verb"):
        write_answer(tmp_path, replace(an_answer(), record=None))
    assert list(tmp_path.iterdir()) == []
