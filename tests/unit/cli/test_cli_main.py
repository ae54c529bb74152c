"""The command as a whole."""

import subprocess
import sys
from importlib.metadata import version

import pytest
from cli_runs import run

VERBS = (
    ("demo",),
    ("simulate",),
    ("fit",),
    ("subject", "check"),
    ("subject", "show"),
    ("subject", "export"),
    ("subject", "import-osim"),
)


def test_the_version_is_that_of_the_package() -> None:
    assert run("--version").stdout == f"identknee {version('identknee')}\n"


def test_without_a_verb_the_help_is_shown() -> None:
    result = run()
    assert result.exit_code == 2
    for verb in VERBS:
        assert verb[0] in result.output


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_the_same_four_options(verb: tuple[str, ...]) -> None:
    result = run(*verb, "--help")
    assert result.exit_code == 0
    for option in ("--out DIR", "--seed", "--workers", "--json"):
        assert option in result.stdout


def test_an_unknown_verb_is_refused() -> None:
    result = run("fti")
    assert result.exit_code == 2
    assert "No such command 'fti'" in result.stderr


def test_the_module_is_the_command() -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "identknee.cli.main", "--help"],
        check=True,
        capture_output=True,
        text=True,
    )
    assert "SUBJECT is a subject folder or the word reference" in answer.stdout
