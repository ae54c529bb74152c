"""Records declared once: read-only, stored, loaded and documented from their fields alone."""

import json
import pickle
from collections.abc import Mapping
from dataclasses import replace
from enum import Enum

import numpy as np
import pytest

from identknee.runs.declare import Array, IntArray, array, declared, derived, entry
from identknee.runs.errors import InputError
from identknee.runs.files import plain
from identknee.runs.schema import from_plain, summary_of, to_plain
from identknee.verbs.files import groups_of, with_arrays


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


@declared
class Part:
    """A part of a whole."""

    size: float | None = entry("Size of the part", unit="mm")
    colour: Colour = entry("Colour of the part")
    path: Array = array("Way along the part", "point", unit="mm")
    steps: IntArray = array("Steps along it", "point", dtype=int)
    spare: Array | None = array("A path that may be missing", "axis", unit="mm", default=None)


@declared
class Group:
    """Parts that belong together."""

    first: Part = entry("The first part")
    rest: tuple[Part, ...] = entry("The other parts", rows="rest")


@declared
class Box:
    """A record of arrays and names alone."""

    sides: tuple[str, ...] = array("Names of the sides", "side", is_in_arrays=False)
    lower: Array = array("Lower bound", "side", unit="mm")


@declared
class Search:
    """A record whose entries stand among those of the result that holds it."""

    method: str = entry("How it was searched")
    kinds: IntArray = array("What is at each end", "search", dtype=int, words=("minimum", "valley"))
    ends: tuple[Part, ...] = entry(
        "The ends, in the arrays alone", rows="part", group="ends", is_in_json=False
    )
    own: Group | None = entry("Parts of its own", default=None)

    @property
    @derived("How many ends are listed", key="ends")
    def n_ends(self) -> int:
        """Number of ends."""
        return len(self.ends)


@declared
class Whole:
    """A result with everything that a result may hold."""

    names: tuple[str, ...] = array("Names along an axis", "name", is_in_arrays=False)
    weights: Array = array("Weight by name", "name", unit="kN")
    parts: Mapping[str, Part] = entry("Parts by name", rows="part", group="parts")
    groups: tuple[Group, ...] = entry("Groups of parts", rows="group", group="groups")
    inner: Part = entry("A part of its own", group="inner")
    box: Box = entry("Bounds, in the arrays alone", group="box", is_in_json=False)
    search: Search = entry("How it was found", is_inline=True)
    remark: str = entry("A remark", default="none")
    unknown: float = entry("A number that may be unknown", unit="1", default=np.nan)

    @property
    @derived("How many parts there are", unit="1")
    def n_parts(self) -> int:
        """Number of parts."""
        return len(self.parts)


def part(n: int, **more: object) -> Part:
    values = {"size": None if n == 2 else 1.5, "colour": Colour.BLUE}
    return Part(**{**values, "path": np.arange(n), "steps": range(n), **more})  # type: ignore[arg-type]


@pytest.fixture
def whole() -> Whole:
    """Parts of different lengths, one of them with what others lack."""
    return Whole(
        names=("a", "b"),
        weights=np.array([1.0, 2.0]),
        parts={"x": part(2), "y": part(3, spare=[1.0, 2.0, 3.0])},
        groups=(
            Group(first=part(1), rest=(part(2), part(4))),
            Group(first=part(2), rest=(part(1), part(1))),
        ),
        inner=part(3),
        box=Box(sides=("left", "right"), lower=[0.0, 1.0]),  # type: ignore[arg-type]
        search=Search(method="newton", kinds=[0, 1, 0], ends=(part(1), part(3))),  # type: ignore[arg-type]
    )


def same(one: object, other: object) -> bool:
    """Whether two records hold the same, NaN included."""
    return json.dumps(to_plain(one)) == json.dumps(to_plain(other))


def test_arrays_and_mappings_are_read_only(whole: Whole) -> None:
    with pytest.raises(ValueError, match="read-only"):
        whole.weights[0] = 3.0
    with pytest.raises(TypeError):
        whole.parts["z"] = part(1)  # type: ignore[index]
    assert whole.inner.steps.dtype == np.int64


def test_arrays_along_one_axis_have_one_length() -> None:
    with pytest.raises(ValueError, match=r"steps.* 2"):
        Part(size=1.0, colour=Colour.RED, path=[0.0, 1.0], steps=[0])  # type: ignore[arg-type]


def test_names_and_arrays_along_one_axis_have_one_length(whole: Whole) -> None:
    with pytest.raises(ValueError, match=r"weights.* 3"):
        replace(whole, names=("a", "b", "c"))


def test_a_code_that_means_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match=r"kinds.*minimum.*valley"):
        Search(method="newton", kinds=np.array([0, 2]), ends=())


def test_meanings_units_and_axes_are_in_the_docstring() -> None:
    assert "Way along the part [mm], shape ``(point,)``." in (Part.__doc__ or "")


def test_a_record_survives_a_pickle(whole: Whole) -> None:
    again = pickle.loads(pickle.dumps(whole))
    assert same(again, whole)
    assert not again.weights.flags.writeable


def test_a_record_comes_back_from_plain_values(whole: Whole) -> None:
    assert same(from_plain(Whole, json.loads(json.dumps(to_plain(whole)))), whole)


def test_a_record_comes_back_from_its_summary_and_its_groups(whole: Whole) -> None:
    summary = json.loads(json.dumps(plain(summary_of(whole))))
    assert "path" not in summary["inner"]
    assert summary["n_parts"] == 2
    groups = groups_of(whole)
    assert groups["parts"]["path"].attrs == {"units": "mm", "long_name": "Way along the part"}
    assert groups["parts"]["path"].dims == ("part", "point")
    assert groups["groups"]["rest_path"].dims == ("group", "rest", "point")
    assert groups["parts"]["colour"].values.tolist() == ["blue", "blue"]
    assert summary["method"] == "newton"
    assert summary["ends"] == 2
    assert "search" not in summary
    assert groups["result"]["kinds"].attrs["flag_meanings"] == "minimum valley"
    again = from_plain(Whole, with_arrays(Whole, summary, groups))
    assert same(again, whole)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("colour", "green", "inner/colour"),
        ("size", "large", "inner/size"),
        ("path", [[0.0]], "must have shape"),
        ("steps", [0, 1], "must have shape"),
    ],
)
def test_a_wrong_value_is_refused_with_its_place(
    whole: Whole, key: str, value: object, said: str
) -> None:
    values = to_plain(whole)
    values["inner"][key] = value
    with pytest.raises(InputError, match=said):
        from_plain(Whole, values)


def test_a_missing_value_is_refused_and_a_default_is_not(whole: Whole) -> None:
    values = to_plain(whole)
    del values["remark"]
    assert from_plain(Whole, values).remark == "none"
    del values["inner"]
    with pytest.raises(InputError, match="inner"):
        from_plain(Whole, values)
