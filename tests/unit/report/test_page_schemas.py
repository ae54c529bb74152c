"""Results that are damaged are told so before a page is made of them."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import xarray

from identknee.report.results import found_results
from identknee.runs.errors import InputError
from identknee.runs.files import digest
from identknee.verbs.files import load
from identknee.verbs.registry import verb_named

RESULTS = Path(__file__).parents[2] / "fuzz" / "results"
Groups = dict[str, xarray.Dataset]


def groups_of(verb: str) -> Groups:
    with xarray.open_datatree(RESULTS / verb / "result.nc", engine="netcdf4") as tree:
        return {name: node.to_dataset().load() for name, node in tree.children.items()}


def summary_of(verb: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((RESULTS / verb / "result.json").read_text("utf-8"))
    return found


# Folders with an answer; one verb may have several.
STORED = [x.name for x in RESULTS.iterdir() if verb_named(summary_of(x.name)["record"]["verb"])]


def refused(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        found_results(folder)
    assert "again" in caught.value.remedy
    return str(caught.value).removeprefix(f"{folder}/")


@pytest.mark.parametrize(
    ("verb", "change", "said"),
    [
        ("fit", lambda x: x.pop("rmse"), "result.json, rmse: the key 'rmse' is missing"),
        (
            "fit",
            lambda x: x["parameters"].pop("ACL"),
            "result.json, parameters: it does not agree",
        ),
        (
            "fit",
            lambda x: x["start_parameters"].pop("ACL"),
            "result.json, start_parameters: it does not agree",
        ),
        (
            "profile",
            lambda x: x["parameters"]["ACL.stiffness_kN"].update(value="9"),
            "result.json, parameters/ACL.stiffness_kN/value: '9' is not a number",
        ),
        (
            "profile",
            lambda x: x["parameters"]["ACL.stiffness_kN"].update(verdict="sure"),
            "result.json, parameters/ACL.stiffness_kN/verdict: 'sure': Input should be 'identif",
        ),
        (
            "profile",
            lambda x: x["parameters"]["ACL.stiffness_kN"].update(lower=9.0),
            "result.json, parameters: it does not agree with the rest of the result",
        ),
        (
            "sweep",
            lambda x: x["kinds"].update(minima=3),
            "result.json, kinds: it does not agree with the rest of the result",
        ),
        (
            "design",
            lambda x: x.update(chosen=[99]),
            "result.json: a trial that was chosen is none of the candidates",
        ),
        (
            "diagnose",
            lambda x: x["parameters_after"].update(ACL={}),
            "result.json: the parameters before and after do not name the same",
        ),
        (
            "sample",
            lambda x: x["record"].update(seconds=10**400),
            "result.json",
        ),
    ],
)
def test_a_damaged_summary(
    tmp_path: Path, verb: str, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    summary = summary_of(verb)
    change(summary)
    if verb_named(verb) is not None:
        shutil.copy(RESULTS / verb / "result.nc", tmp_path)
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
    assert re.match(r"result\.nc.*result\.json", refused(tmp_path))


@pytest.mark.parametrize("verb", STORED)
def test_a_stored_answer_is_whole(verb: str) -> None:
    assert load(RESULTS / verb).record is not None


def damaged(folder: Path, verb: str, change: Callable[[xarray.DataTree], None]) -> Path:
    """A stored answer whose arrays were changed as if the verb had written them so."""
    shutil.copytree(RESULTS / verb, folder, dirs_exist_ok=True)
    path = folder / "result.nc"
    with xarray.open_datatree(path, engine="netcdf4") as tree:
        tree = tree.load()
    change(tree)
    tree.to_netcdf(path, engine="netcdf4")
    summary = summary_of(verb)
    summary["record"]["arrays"] = digest(path)
    (folder / "result.json").write_text(json.dumps(summary), encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("theta", "the key 'theta' is missing"),
        ("delta_deviance", "the key 'delta_deviance' is missing"),
        ("n_point", ""),
    ],
)
def test_an_answer_without_one_of_its_arrays(tmp_path: Path, name: str, said: str) -> None:
    def drop(tree: xarray.DataTree) -> None:
        tree["profile"] = tree["profile"].to_dataset().drop_vars(name)

    folder = damaged(tmp_path, "profile", drop)
    if said:
        assert said in refused(folder)
    else:
        assert len(found_results(folder)) == 1


def test_an_answer_with_an_array_of_another_length(tmp_path: Path) -> None:
    def cut(tree: xarray.DataTree) -> None:
        tree["profile"] = tree["profile"].to_dataset().isel(point=slice(2))

    assert "not agree" in refused(damaged(tmp_path, "profile", cut))


def test_an_answer_with_a_code_that_means_nothing(tmp_path: Path) -> None:
    def change(tree: xarray.DataTree) -> None:
        data = tree["optimization"].to_dataset()
        tree["optimization"] = data.assign(kind=data["kind"] + 99)

    folder = damaged(tmp_path, "sweep", change)
    assert re.search(r"kind_codes.*minimum.*valley", refused(folder))


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({"coordinate": list("abcde")}, "its axis coordinate has other names than elsewhere"),
        ({"trial": ["x"] * 7}, "its axis trial names something twice"),
        ({"trial": list("abcdefg")}, "its axis trial has other names than elsewhere"),
    ],
)
def test_an_answer_whose_groups_name_other_things(
    tmp_path: Path, names: dict[str, list[str]], said: str
) -> None:
    def rename(tree: xarray.DataTree) -> None:
        tree["predictions"] = tree["predictions"].to_dataset().assign_coords(names)

    assert said in refused(damaged(tmp_path, "fit", rename))
