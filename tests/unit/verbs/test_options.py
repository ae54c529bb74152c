"""Options are said once: signature, docstring and command follow from it."""

import inspect
import re
from collections.abc import Callable
from typing import Any

import pytest

import identknee as ik
from identknee.cli.app import command_of
from identknee.report.presenter import PRESENTERS
from identknee.verbs.options import as_typed, option_of, parameters_in_full
from identknee.verbs.printer import Printer, set_printer
from identknee.verbs.registry import Verb, verbs

COMMANDS = [x for x in verbs() if x.summary]


@pytest.mark.parametrize("verb", COMMANDS, ids=lambda x: x.name)
def test_a_command_has_the_options_of_its_verb_with_their_texts_and_defaults(verb: Verb) -> None:
    command = {x.name: x for x in command_of(verb).params}
    known = parameters_in_full(verb.call)
    for name, own in known.items():
        said = option_of(own.annotation)
        if not said.is_typed:
            assert name not in command
            continue
        shown = command[name]
        assert str(shown.help).startswith(as_typed(said.text))  # type: ignore[attr-defined]
        if name == "out":
            assert str(shown.default) == verb.folder
        elif own.default is not own.empty and own.default is not None:
            assert str(own.default) in str(shown.default)
    assert set(command) - set(known) <= {"as_json", "is_verbose", "seed", "workers", "help"}


@pytest.mark.parametrize("verb", COMMANDS, ids=lambda x: x.name)
def test_a_docstring_lists_what_the_signature_has(verb: Verb) -> None:
    section = (verb.call.__doc__ or "").split("Parameters\n----------\n")[1].split("\n\n")[0]
    assert re.findall(r"^(\w+)$", section, re.MULTILINE) == [
        *inspect.signature(verb.call).parameters
    ]


@pytest.mark.parametrize("function", [ik.fit, ik.sensitivity, ik.simulate])
def test_no_option_shows_in_a_signature_what_is_said_of_it(function: Callable[..., Any]) -> None:
    assert "Option(" not in str(inspect.signature(function))


def test_every_answer_is_shown_by_something() -> None:
    # What blind data say must not tell what is hidden in them.
    assert {x.answer for x in verbs()} == {*PRESENTERS, "BlindData"}


def test_without_a_printer_an_answer_is_its_class_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = ik.verbs.describe_subject("reference")

    def shown_by() -> Printer:
        from identknee.report import printer

        return printer

    try:
        monkeypatch.setattr("identknee.verbs.printer._given", [])
        assert str(answer) == repr(answer) == "SubjectFacts"
        with pytest.raises(ValueError, match="here draws"):
            answer.plot()
    finally:
        monkeypatch.undo()
        set_printer(shown_by)
    assert "reference" in str(answer)
