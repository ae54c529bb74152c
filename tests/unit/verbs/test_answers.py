"""Every answer of a verb: declared in full, and a field of it in one place."""

from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest
from report_folders import KNEE, straight_profiles

import identknee as ik
from identknee.runs.declare import declared, derived_entries, entries, entry
from identknee.runs.errors import InputError
from identknee.runs.record import record
from identknee.runs.schema import record_within, summary_of, type_hints_of
from identknee.verbs import registry
from identknee.verbs.files import groups_of, load, write_answer
from identknee.verbs.profile import Profiles
from identknee.verbs.registry import Verb, verbs


def classes(cls: type) -> Iterator[type]:
    yield cls
    for hint in type_hints_of(cls).values():
        kind, _ = record_within(hint)
        if kind is not None:
            yield from classes(kind)


@pytest.mark.parametrize("verb", verbs(), ids=lambda x: x.name)
def test_every_field_says_what_it_holds(verb: Verb) -> None:
    for cls in classes(verb.answer_class):
        known = entries(cls)
        assert set(known) == set(cls.__dataclass_fields__)  # type: ignore[attr-defined]
        for name, about in (known | derived_entries(cls)).items():
            where = f"{cls.__name__}.{name}"
            assert len(about.meaning) > 5, where
            assert not about.meaning.endswith("."), where
            if type_hints_of(cls).get(name) in (float, float | None):
                assert about.unit, f"{where} has no unit"


@declared
class Longer(Profiles):
    """An answer with a field more."""

    temperature: float = entry("Temperature of the laboratory", unit="deg C", default=21.5)


def test_a_new_field_is_stored_loaded_and_documented(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing but its declaration is needed."""
    made = straight_profiles()
    fields = {name: getattr(made, name) for name in entries(Profiles)}
    given = record("longer", {}, {"subject": KNEE}, 0).finish()
    answer = Longer(**{**fields, "temperature": 18.25, "record": given})
    longer = Verb(name="longer", module=__name__, function="", answer="Longer")
    monkeypatch.setattr(registry, "_VERBS", [*verbs(), longer])
    monkeypatch.syspath_prepend(str(Path(ik.__file__).parents[1] / "docs"))
    write_answer(tmp_path, answer)
    again = load(tmp_path)
    page = import_module("pages.answers").answer_reference_page()
    assert isinstance(again, Longer)
    assert again.temperature == 18.25
    assert "| `temperature` | deg C |  | json | Temperature of the laboratory |" in page


def test_a_summary_that_was_changed_by_hand_is_refused(tmp_path: Path) -> None:
    given = record("profile", {}, {"subject": KNEE}, 0).finish()
    write_answer(tmp_path, replace(straight_profiles(), record=given))
    path = tmp_path / "result.json"
    path.write_text(path.read_text("utf-8").replace('"n_points": ', '"n_points": 1'), "utf-8")
    with pytest.raises(InputError, match="not agree"):
        load(tmp_path)


def test_numbers_are_in_the_summary_and_arrays_in_groups() -> None:
    answer = straight_profiles()
    assert summary_of(answer)["parameters"]["x1.value_pct"]["lower_status"] == "closed"
    assert groups_of(answer)["profile"]["delta_deviance"].dims == ("quantity", "point")
