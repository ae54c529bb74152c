"""The help of every command, as the terminal shows it."""

from pathlib import Path

from typer.testing import CliRunner

from identknee.cli.app import app

MANY_COLUMNS = {"COLUMNS": "100", "TERM": "dumb"}
# Not a verb, but what holds some of them.
GROUP = "subject"


def write_commands(path: Path) -> None:
    """Write a section for each command."""
    verbs = [verb for verb in _listed() if verb != GROUP]
    commands = [[], *([GROUP, verb] for verb in _listed(GROUP)), *([verb] for verb in verbs)]
    path.write_text("\n".join(_section(words) for words in commands), encoding="utf-8")


def _listed(*words: str) -> list[str]:
    """Verbs in the help of a command."""
    lines = _help(*words).split("Commands:\n", 1)[1].splitlines()
    return [line.split()[0] for line in lines if line[:2] == "  " and line[2] != " "]


def _section(words: list[str]) -> str:
    name = " ".join(["identknee", *words])
    return f"## {name}\n\n```text\n{_help(*words).strip()}\n```\n"


def _help(*words: str) -> str:
    result = CliRunner().invoke(app, [*words, "--help"], prog_name="identknee", env=MANY_COLUMNS)
    return result.output
