"""Files against schemas: what is wrong first, in words."""

import json
from pathlib import Path
from typing import Annotated

import pytest

from identknee.runs.errors import InputError
from identknee.runs.files import BACKSLASH
from identknee.runs.schema import (
    Fault,
    Number,
    Part,
    custom_message,
    number,
    read_json,
    read_toml,
    refusal,
    remedy_of,
    shown,
    validated,
)


class Inner(Part):
    size: Number
    names: Annotated[list[str], custom_message("{} is no list of names", "Write a list.")] = []  # noqa: RUF012


class Outer(Part):
    inner: Inner
    more: list[Inner] = []  # noqa: RUF012
    angle: Annotated[float, number("{} is no angle", "Write one.", "Measure it.")] = 0.0


def fault(values: object) -> Fault:
    found: list[Fault] = []

    def refuse(first: Fault) -> InputError:
        found.append(first)
        return InputError("x.toml", "", first.why, first.remedy)

    with pytest.raises(InputError):
        validated(Outer, values, refuse)
    return found[0]


@pytest.mark.parametrize(
    ("values", "place", "why", "remedy"),
    [
        ({}, (), "the key 'inner' is missing", "Add inner = {}."),
        ({"iner": {}}, (), "there is no key 'iner' here", "Did you mean inner?"),
        ({"inner": {"size": 1, "sise": 2}}, ("inner",), "no key 'sise'", "Did you mean size?"),
        ({"inner": 3}, ("inner",), "3 is not a table", "Write inner = {}."),
        ({"inner": {"size": "1"}}, ("inner", "size"), "'1' is not a number", "without quotes."),
        ({"inner": {"size": True}}, ("inner", "size"), "True is not a number", "without quotes."),
        ({"inner": {"size": 1e999}}, ("inner", "size"), "inf is not a finite", "the measured"),
        ({"inner": {"size": 10**400}}, ("inner", "size"), "... is not a finite number", "measured"),
        ({"inner": {"size": 1, "names": 3}}, ("inner", "names"), "3 is no list", "Write a list."),
        ({"inner": {"size": 1, "names": [3]}}, ("inner", "names", 0), "3 is not text", "names."),
        ({"inner": {"size": 1}, "more": [{}]}, ("more", 0), "'size' is missing", "Add size."),
        ({"inner": {"size": 1}, "angle": "x"}, ("angle",), "'x' is no angle", "Write one."),
        ({"inner": {"size": 1}, "angle": float("nan")}, ("angle",), "nan is not", "Measure it."),
        ([], (), "[] is not a table", "Write it."),
    ],
)
def test_the_first_fault_has_its_place_and_remedy(
    values: object, place: tuple[str | int, ...], why: str, remedy: str
) -> None:
    found = fault(values)
    assert found.place == place
    assert why in found.why
    assert remedy in remedy_of(Outer, found, {"inner": "inner = {}"})


def test_what_fits_comes_back_unchanged() -> None:
    def never(first: Fault) -> InputError:
        raise AssertionError(first)

    found = validated(Outer, {"inner": {"size": 2}, "angle": 1.5}, never)
    assert (found.inner.size, found.angle, found.more) == (2, 1.5, [])


def test_own_words_survive_braces() -> None:
    error = refusal("{x} is wrong", "Write {y}.")
    assert error.context == {"why": "{x} is wrong", "remedy": "Write {y}."}


def test_long_values_are_cut() -> None:
    for value in ("x" * 100, 10**5000, [[1] * 100] * 100):
        assert len(shown(value)) <= 60


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"{", "this is not JSON. Correct the file."),
        (b'"\xff"', "this is not JSON. Correct the file."),
        (b'"\\ud800"', "this is not JSON. Correct the file."),
        (b"1" * 5000, "this is not JSON. Correct the file."),
        (b"[" * 100_000, "nested too deeply. Correct the file."),
    ],
)
def test_what_is_no_json_is_told(tmp_path: Path, content: bytes, why: str) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=why):
        read_json(path, "Correct the file.")
    path.write_text(json.dumps({"a": [1.5, None]}), encoding="utf-8")
    assert read_json(path, "Mend.") == {"a": [1.5, None]}


def test_toml_may_begin_with_the_mark_of_its_encoding(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert read_toml(path) == {"a": 1}
    with pytest.raises(InputError, match="1e-06 MB"):
        read_toml(path, 1e-6)


@pytest.mark.parametrize(
    ("row", "within"),
    [
        (r'femur = "C:\Users\x\femur.ply"', r"C:\Users\x\femur.ply"),
        (r'femur = "meshes\medial.ply"', r"meshes\medial.ply"),
        ('femur = "C:\\data\\"', "C:\\data\\"),
        (r"""femur = {a = 'C:\x', b = "D:\x"}""", r"D:\x"),
    ],
)
def test_a_windows_path_between_double_quotes_is_named_with_its_line(
    tmp_path: Path, row: str, within: str
) -> None:
    path = tmp_path / "x.toml"
    path.write_text(f"a = 1\n\n{row}\nb = 'c'\n")
    with pytest.raises(InputError) as caught:
        read_toml(path)
    assert (caught.value.path, caught.value.where) == (str(path), "line 3")
    assert f'"{within}"' in caught.value.why
    assert caught.value.remedy == BACKSLASH
    # Between single quotes, or with slashes, all is well; other faults are reported as they were.
    path.write_text("a = 'C:\\Users\\x.ply'\nb = \"C:/Users/x.ply\"")
    assert read_toml(path) == {"a": "C:\\Users\\x.ply", "b": "C:/Users/x.ply"}
    path.write_text("a = 'C:\\Users'\nb = ")
    with pytest.raises(InputError) as other:
        read_toml(path)
    assert other.value.remedy != BACKSLASH
