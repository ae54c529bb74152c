"""Results that are damaged are told so before a page is made of them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

from identknee.report.page.agreement import disagreement
from identknee.report.page.array_schema import array_fault
from identknee.report.page.results import found_results
from identknee.runs.errors import InputError

RESULTS = Path(__file__).parents[2] / "fuzz" / "results"
Groups = dict[str, xarray.Dataset]


def groups_of(verb: str) -> Groups:
    with xarray.open_datatree(RESULTS / verb / "result.nc", engine="h5netcdf") as tree:
        return {name: node.to_dataset().load() for name, node in tree.children.items()}


def summary_of(verb: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((RESULTS / verb / "result.json").read_text("utf-8"))
    return found


def refused(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        found_results(folder)
    assert caught.value.remedy == "Run the command that made it again."
    return str(caught.value).removeprefix(f"{folder}/")


@pytest.mark.parametrize(
    ("verb", "change", "said"),
    [
        ("fit", lambda x: x.pop("rmse"), "result.json, rmse: the key 'rmse' is missing"),
        ("fit", lambda x: x["parameters"].pop("ACL"), ""),
        (
            "fit",
            lambda x: x["start_parameters"].pop("ACL"),
            "result.json: parameters and start_parameters do not name the same",
        ),
        (
            "profile",
            lambda x: x["parameters"]["ACL.stiffness_kN"].update(lower="9"),
            "result.json, parameters/ACL.stiffness_kN/lower: '9' is not a number",
        ),
        (
            "profile",
            lambda x: x["parameters"]["ACL.stiffness_kN"].update(verdict="sure"),
            "result.json, parameters/ACL.stiffness_kN/verdict: 'sure' is none of identifiable",
        ),
        (
            "sweep",
            lambda x: x["kinds"].update(minima=3),
            "result.json, kinds/minima/[key]: 'minima' is none of minimum, valley",
        ),
        (
            "design",
            lambda x: x["targets"].clear(),
            "result.json, targets: {}: Dictionary should have at least 1 item",
        ),
        (
            "diagnose",
            lambda x: x["parameters_after"].update(ACL={}),
            "result.json: the parameters before and after do not name the same",
        ),
        (
            "sample",
            lambda x: x["record"].update(seconds=10**400),
            "result.json, record/seconds: 1000",
        ),
    ],
)
def test_a_damaged_summary(
    tmp_path: Path, verb: str, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    summary = summary_of(verb)
    change(summary)
    (tmp_path / "result.json").write_text(json.dumps(summary), encoding="utf-8")
    if said:
        assert refused(tmp_path).startswith(said)
    else:
        assert len(found_results(tmp_path)) == 1


def test_arrays_that_are_not_those_that_were_written(tmp_path: Path) -> None:
    shutil.copytree(RESULTS / "fit", tmp_path, dirs_exist_ok=True)
    assert found_results(tmp_path)
    content = bytearray((tmp_path / "result.nc").read_bytes())
    content[-1] ^= 1
    (tmp_path / "result.nc").write_bytes(content)
    assert refused(tmp_path).startswith("result.nc: it is not the file that was written with")


@pytest.mark.parametrize("verb", sorted(x.name for x in RESULTS.iterdir()))
def test_whole_arrays_have_no_fault(verb: str) -> None:
    groups = groups_of(verb)
    assert array_fault(verb, groups) is None
    if verb != "check":
        assert disagreement(summary_of(verb), groups) is None


@pytest.mark.parametrize(
    ("verb", "group", "change", "said"),
    [
        ("fit", "predictions", lambda x: x.drop_vars("theta"), "there is no variable theta"),
        (
            "fit",
            "predictions",
            lambda x: x.assign(theta=("parameter", ["x"] * x.sizes["parameter"])),
            "it holds <U1 and no numbers",
        ),
        (
            "fit",
            "predictions",
            lambda x: x.assign(theta=("parameter", np.full(x.sizes["parameter"], np.nan))),
            "a number is missing",
        ),
        (
            "fit",
            "predictions",
            lambda x: x.assign(coordinates=x["coordinates"].T),
            "its axes are coordinate, trial",
        ),
        ("fit", "predictions", lambda x: x.isel(trial=slice(3)), "not those of constant_data"),
        (
            "fit",
            "observed_data",
            lambda x: x.assign_coords(coordinate=list("abcde")),
            "it is not lateral_shift_mm, ",
        ),
        (
            "fit",
            "constant_data",
            lambda x: x.assign_coords(trial=["x"] * x.sizes["trial"]),
            "it names something twice",
        ),
        ("profile", "profile", lambda x: 1e200 * x["value"].to_dataset(), "there is no variable"),
    ],
)
def test_damaged_arrays(
    verb: str, group: str, change: Callable[[xarray.Dataset], xarray.Dataset], said: str
) -> None:
    groups = groups_of(verb)
    found = array_fault(verb, groups | {group: change(groups[group])})
    assert found is not None
    assert said in found[1]


@pytest.mark.parametrize(
    ("verb", "group", "change", "said"),
    [
        ("profile", "profile", lambda x: x.assign_coords(quantity=["a"]), "a is not in result"),
        ("profile", "profile", lambda x: x.assign(value=x["value"] * np.nan), "has no points"),
        ("design", "design", lambda x: x.assign_coords(target=["a"]), "a is not in result.json"),
        ("design", "design", lambda x: x.assign(chosen=x["chosen"] + 99), "of no candidate"),
        ("sweep", "optimization", lambda x: x.assign(kind=x["kind"] + 99), "no outcome"),
        ("morris", "sensitivity", lambda x: x.assign(sigma=-x["sigma"]), "a size is below zero"),
        ("morris", "sensitivity", lambda x: x.assign(sigma=x["sigma"] + np.inf), "is infinite"),
        ("morris", "sensitivity", lambda x: x.drop_vars("sigma"), "there is no variable sigma"),
        ("sample", "posterior", lambda x: x.drop_vars("parameter"), "of which parameters it is"),
        ("sample", "posterior", lambda x: x.drop_vars("theta"), "some of its draws are missing"),
    ],
)
def test_arrays_beside_another_summary(
    verb: str, group: str, change: Callable[[xarray.Dataset], xarray.Dataset], said: str
) -> None:
    groups = groups_of(verb)
    found = disagreement(summary_of(verb), groups | {group: change(groups[group])})
    assert found is not None
    assert said in found[1]
