"""Sentences are short: in the README, the pages, the help of every command, and results."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from sentence_lengths import long_sentences

from identknee.cli.app import WaitingCommand, app, command_of
from identknee.report.presenter import statements_of
from identknee.verbs.files import load

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "tests" / "fuzz" / "results"
MOST_WORDS = 1200
PAGES = [
    *(ROOT / x for x in ("README.md", "CONTRIBUTING.md", "VISION.md", "tests/README.md")),
    *(x for x in sorted((ROOT / "docs").glob("*.md")) if len(x.read_text("utf-8").split()) > 100),
    *sorted((ROOT / "studies").glob("*/README.md")),
]


def helps(command: typer.core.TyperCommand, name: str = "identknee") -> Iterator[tuple[str, str]]:
    """By command its help with that of its options, and so on for the commands below it."""
    if isinstance(command, WaitingCommand):
        command = command_of(command.verb)
    options = [getattr(x, "help", None) or "" for x in command.params]
    yield name, "\n\n".join([command.help or "", *options])
    for below in getattr(command, "commands", {}).values():
        yield from helps(below, f"{name} {below.name}")


HELPS = dict(helps(typer.main.get_command(app)))  # type: ignore[arg-type]


def test_the_readme_is_short() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= MOST_WORDS


@pytest.mark.parametrize("page", PAGES, ids=lambda x: str(x.relative_to(ROOT)))
def test_sentences_of_a_page_are_short(page: Path) -> None:
    assert long_sentences(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("name", HELPS)
def test_sentences_of_the_help_are_short(name: str) -> None:
    assert long_sentences(HELPS[name]) == []


@pytest.mark.parametrize("verb", sorted(x.name for x in RESULTS.iterdir() if x.name != "check"))
def test_sentences_of_a_result_are_short(verb: str) -> None:
    said = "\n\n".join(x.sentence for x in statements_of(load(RESULTS / verb)))
    assert long_sentences(said) == []
