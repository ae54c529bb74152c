"""What stored results and the help of every command say, word by word.

After a change of words: `python -m pytest tests/golden --golden` writes the texts anew, and the
difference is read in the commit.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from identknee.cli.app import app
from identknee.cli.verb_command import WaitingCommand, command_of
from identknee.report.printer import terminal_lines
from identknee.verbs.files import load

HERE = Path(__file__).parent
RESULTS = HERE.parent / "fuzz" / "results"


def _commands(
    command: typer.core.TyperCommand, name: str = "identknee"
) -> Iterator[tuple[str, typer.core.TyperCommand]]:
    if isinstance(command, WaitingCommand):
        command = command_of(command.verb)
    yield name, command
    for below in getattr(command, "commands", {}).values():
        yield from _commands(below, f"{name} {below.name}")


COMMANDS = dict(_commands(typer.main.get_command(app)))  # type: ignore[arg-type]


@pytest.fixture
def compare(request: pytest.FixtureRequest) -> Iterator[list[tuple[Path, str]]]:
    """Texts put into the list are those kept in files, or become them with ``--golden``."""
    found: list[tuple[Path, str]] = []
    yield found
    for path, text in found:
        if request.config.getoption("--golden"):
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        assert path.read_text(encoding="utf-8") == text


@pytest.mark.parametrize("verb", sorted(x.name for x in RESULTS.iterdir()))
def test_a_stored_result_says_what_it_said(verb: str, compare: list[tuple[Path, str]]) -> None:
    text = "\n".join(terminal_lines(load(RESULTS / verb)))
    compare.append((HERE / "results" / f"{verb}.txt", f"{text}\n"))


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_says_what_it_said(
    name: str, compare: list[tuple[Path, str]]
) -> None:
    """Its words, whatever the library that prints them makes of their places."""
    command = COMMANDS[name]
    lines = [command.help or "", command.epilog or ""]
    for option in command.params:
        words = (getattr(option, "help", None) or "").split()
        given = "" if option.default is None else f" [{option.default}]"
        names = ", ".join((*option.opts, *option.secondary_opts))
        lines.append(f"{names}{given}: {' '.join(words)}")
    compare.append((HERE / "help" / f"{name.replace(' ', '-')}.txt", "\n".join(lines) + "\n"))
