"""The page on the subject file lists the keys that are read, and its left knee is one."""

import doctest
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

import pytest

import identknee as ik
from identknee.runs.schema import Part
from identknee.runs.words import unit_of
from identknee.subject.folder import SubjectTables

PAGE = Path(ik.__file__).parents[1] / "docs" / "subject_file.md"
TOP = "Top of the file"
# Names of a user's own, as the page writes them, in tables whose keys are such names.
OWN = {
    "bounds": '"PARAMETER"',
    "priors": '"PARAMETER"',
    "effects.values": "AMPLITUDE",
    "uncertainty.insertions_mm": "LIGAMENT",
}


def form_of(given: Any) -> str:
    """What a value is in a file, by the annotation of its key."""
    if get_origin(given) is Literal:
        return "choice"
    plain = get_args(given)[0] if get_origin(given) is Annotated else given
    origin = get_origin(plain) or plain
    if origin is dict or (isinstance(origin, type) and issubclass(origin, Part)):
        return "table"
    return {float: "number", str: "text", list: "list"}.get(origin, "")


def forms_of(given: Any) -> set[str]:
    """All that a value may be."""
    known = form_of(given)
    return {known} if known else set().union(*map(forms_of, set(get_args(given)) - {NoneType}))


def tables_in(given: Any, where: str) -> Iterator[tuple[str, type[Part] | None]]:
    """The tables in the value of a key by their places; None where every key is a number."""
    if isinstance(given, type) and issubclass(given, Part):
        yield where, given
    elif get_origin(given) is dict:
        value = get_args(given)[1]
        below = list(tables_in(value, f"{where}.{OWN[where]}"))
        yield from below or [(where, None)]
    else:
        for inner in get_args(given):
            yield from tables_in(inner, where)


def keys_read(table: type[Part], where: str = "") -> Iterator[tuple[str, str, set[str], str]]:
    """Place, key, forms and default of all that the reader accepts."""
    for key, field in table.model_fields.items():
        default = field.default
        said = "none"
        if field.is_required():
            said = "required"
        elif isinstance(default, float):
            said = f"{default:g}"
        elif isinstance(default, str) and default:
            said = f'`"{default}"`'
        # Both frames are headings of the page.
        if where != "frames":
            yield where, key, forms_of(field.annotation), said
        for place, inner in tables_in(field.annotation, f"{where}.{key}".strip(".")):
            if inner is None:
                yield place, OWN[place], {"number"}, "none"
            else:
                yield from keys_read(inner, place)


def keys_shown() -> Iterator[tuple[str, str, str, str, str]]:
    """Place, key, type, unit and default as the page has them."""
    for section in PAGE.read_text(encoding="utf-8").split("\n### ")[1:]:
        head = section.partition("\n")[0]
        places = [""] if head == TOP else re.findall(r"`\[+(.*?)\]+`", head)
        assert places, head
        for line in re.findall(r"^\| (`.*)\|$", section, re.MULTILINE):
            keys, form, unit, default, meaning = (x.strip() for x in line.split("|"))
            assert meaning
            names = re.findall(r"`(.*?)`", keys)
            units = unit.split(", ") if len(names) == unit.count(",") + 1 else [unit] * len(names)
            for place in places:
                for key, its in zip(names, units, strict=True):
                    yield place, key, form, its, default


def test_the_keys_of_the_page_are_those_that_are_read_each_once() -> None:
    shown = [(place, key) for place, key, *_ in keys_shown()]
    read = {(place, key) for place, key, *_ in keys_read(SubjectTables)}
    assert sorted(shown) == sorted(read)


def test_types_and_defaults_are_those_of_the_reader() -> None:
    read = {(place, key): (forms, said) for place, key, forms, said in keys_read(SubjectTables)}
    words = {"number": "number", "text": "text", "table": "table"}
    for place, key, form, _, default in keys_shown():
        forms, said = read[place, key]
        assert default == said, (place, key)
        if "choice" in forms or OWN.get(place) == key:
            continue
        is_list = "points?$|list of|[0-9] (numbers|texts)"
        parts = form.split(" or ")
        named = {"list" if re.search(is_list, x) else words[x] for x in parts}
        assert named == forms, (place, key)


def test_units_are_those_that_names_end_in() -> None:
    for place, key, _, unit, _ in keys_shown():
        if ends_in := unit_of(key):
            assert unit.replace("³", "3").startswith(ends_in), (place, key)


def test_the_left_knee_of_the_page_is_read_as_it_says() -> None:
    text = PAGE.read_text(encoding="utf-8").split("## A left knee")[1].split("\n## ")[0]
    (tables,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (session,) = re.findall(r"```pycon\n(.*?)```", text, re.DOTALL)
    names = {"frames": tomllib.loads(tables)["frames"]}
    example = doctest.DocTestParser().get_doctest(session, names, "left knee", str(PAGE), 0)
    result = doctest.DocTestRunner().run(example)
    assert (result.failed, result.attempted) == (0, 6)


def test_a_left_knee_of_the_file_is_a_right_one_once_read() -> None:
    file = Path(ik.__file__).parent / "subject" / "knees" / "s192803" / "subject.toml"
    whole = tomllib.loads(file.read_text(encoding="utf-8"))
    assert whole["side"] == "left"
    knee = ik.example("s192803")
    for own in whole["ligaments"]:
        given = knee.femur_frame.mirrored().to_local(own["femur"])
        read = knee.femur_frame.to_local(knee.ligament(own["name"]).femur)
        assert read == pytest.approx(given * [1.0, 1.0, -1.0])
