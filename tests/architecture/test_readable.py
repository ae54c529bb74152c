"""Prose is short and easy to read: the README, the pages, and the help of every command."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from reading_ease import prose, reading_ease

from identknee.cli.app import app
from identknee.report.answers.statements import statements_of
from identknee.verbs.files import load

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "tests" / "fuzz" / "results"
EASE = 45.0
MOST_WORDS = 1200
PAGES = [
    *(ROOT / x for x in ("README.md", "CONTRIBUTING.md", "VISION.md", "tests/README.md")),
    *(x for x in sorted((ROOT / "docs").glob("*.md")) if len(x.read_text("utf-8").split()) > 100),
    *sorted((ROOT / "studies").glob("*/README.md")),
]


def helps(command: typer.core.TyperCommand, name: str = "identknee") -> Iterator[tuple[str, str]]:
    """By command its help with that of its options, and so on for the commands below it."""
    options = [getattr(x, "help", None) or "" for x in command.params]
    yield name, "\n\n".join([command.help or "", *options])
    for below in getattr(command, "commands", {}).values():
        yield from helps(below, f"{name} {below.name}")


HELPS = dict(helps(typer.main.get_command(app)))  # type: ignore[arg-type]


def test_the_readme_is_short_and_says_early_whom_it_is_for() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= MOST_WORDS
    second = " ".join(text.split()).split(". ")[1]
    assert second.startswith("It is for researchers in biomechanics")


@pytest.mark.parametrize("page", PAGES, ids=lambda x: str(x.relative_to(ROOT)))
def test_a_page_is_easy_to_read(page: Path) -> None:
    assert reading_ease(prose(page.read_text(encoding="utf-8"))) >= EASE


@pytest.mark.parametrize("name", HELPS)
def test_help_is_easy_to_read(name: str) -> None:
    assert reading_ease(prose(HELPS[name])) >= EASE


@pytest.mark.parametrize("verb", sorted(x.name for x in RESULTS.iterdir() if x.name != "check"))
def test_what_a_result_says_is_easy_to_read(verb: str) -> None:
    said = " ".join(x.sentence for x in statements_of(load(RESULTS / verb)))
    assert reading_ease(prose(said)) >= EASE


def test_long_sentences_of_long_words_are_hard() -> None:
    hard = (
        "The identifiability of viscoelastic constitutive parameters necessitates simultaneous "
        "multidirectional experimental characterisation of heterogeneous ligamentous structures."
    )
    assert reading_ease(hard) < 0.0
    assert reading_ease("The knee is loose. Pull it, and see how far it goes.") > 90.0
