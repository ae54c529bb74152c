"""What stored results and the help of every command say, word by word.

After a change of words: `python -m pytest tests/golden tests/unit --golden` writes the texts anew,
and the difference is read in the commit. Any test can keep a text with the fixture `golden`.
"""

import re
from collections.abc import Iterator
from html import unescape
from pathlib import Path

import pytest
import typer
from golden_texts import Golden

from identknee.cli.app import WaitingCommand, app, command_of
from identknee.report.page.page import report_html
from identknee.report.printer import brief_lines, terminal_lines
from identknee.report.results import found_results
from identknee.verbs.files import load

RESULTS = Path(__file__).parents[1] / "fuzz" / "results"


def _commands(
    command: typer.core.TyperCommand, name: str = "identknee"
) -> Iterator[tuple[str, typer.core.TyperCommand]]:
    if isinstance(command, WaitingCommand):
        command = command_of(command.verb)
    yield name, command
    for below in getattr(command, "commands", {}).values():
        yield from _commands(below, f"{name} {below.name}")


COMMANDS = dict(_commands(typer.main.get_command(app)))  # type: ignore[arg-type]


@pytest.mark.parametrize("verb", sorted(x.name for x in RESULTS.iterdir()))
def test_a_stored_result_says_what_it_said(verb: str, golden: Golden) -> None:
    golden(f"results/{verb}", "\n".join(terminal_lines(load(RESULTS / verb))))


@pytest.mark.parametrize("verb", sorted(x.name for x in RESULTS.iterdir()))
def test_a_command_prints_of_a_stored_result_what_it_printed(verb: str, golden: Golden) -> None:
    golden(f"brief/{verb}", "\n".join(brief_lines(load(RESULTS / verb))))


def _words(page: str) -> str:
    """What a page says, one line an element; the record of how it was computed left out."""
    said = re.sub(r"<(head|style|script|svg|pre)\b.*?</\1>", " ", page, flags=re.DOTALL)
    said = re.sub(r"</?(span|a|em|b|strong|code|td|th|sup|sub)\b[^>]*>", " ", said)
    lines = (" ".join(unescape(x).split()) for x in re.split(r"<[^>]+>", said))
    return "\n".join(x for x in lines if x and "identknee 0." not in x)


@pytest.mark.usefixtures("no_drawings")
@pytest.mark.parametrize("verb", sorted(x.name for x in RESULTS.iterdir() if x.name != "check"))
def test_the_page_of_a_stored_result_says_what_it_said(verb: str, golden: Golden) -> None:
    page = report_html(found_results(RESULTS / verb))
    golden(f"pages/{verb}", _words(page).replace(str(RESULTS), "results"))


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_says_what_it_said(name: str, golden: Golden) -> None:
    """Its words, whatever the library that prints them makes of their places."""
    command = COMMANDS[name]
    lines = [command.help or "", command.epilog or ""]
    for option in command.params:
        words = (getattr(option, "help", None) or "").split()
        given = "" if option.default is None else f" [{option.default}]"
        names = ", ".join((*option.opts, *option.secondary_opts))
        lines.append(f"{names}{given}: {' '.join(words)}")
    golden(f"help/{name.replace(' ', '-')}", "\n".join(lines))
