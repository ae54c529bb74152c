"""Completion of verbs and options by a shell."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-m", "identknee.cli.main"]


def _answer(words: list[str], **variables: str) -> str:
    done = subprocess.run(
        [*COMMAND, *words], check=True, capture_output=True, text=True, env=os.environ | variables
    )
    return done.stdout


def _completed(line: str) -> list[str]:
    """What bash is told when the tabulator is pressed at the end of the line."""
    position = str(len(line.split()) - (not line.endswith(" ")))
    words = {"COMP_WORDS": line, "COMP_CWORD": position}
    return _answer([], _IDENTKNEE_COMPLETE="complete_bash", **words).split()


def test_verbs_are_completed() -> None:
    assert _completed("identknee si") == ["simulate"]
    assert {"demo", "fit", "subject", "doctor"} <= set(_completed("identknee "))
    assert "import-osim" in _completed("identknee subject ")


def test_options_and_their_values_are_completed() -> None:
    assert _completed("identknee simulate reference --cont") == ["--continuation", "--contact"]
    assert _completed("identknee simulate reference --contact ") == ["field", "mesh"]


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_are_told_the_same(shell: str) -> None:
    variables = {
        "_IDENTKNEE_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": "identknee si",
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    assert "simulate" in _answer([], **variables)


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
def test_what_is_shown_works_in_bash(tmp_path: Path) -> None:
    """Its script, read by a shell that finds the command on its path."""
    (tmp_path / "identknee").write_text(
        f'#!/bin/sh\nexec "{sys.executable}" -m identknee.cli.main "$@"\n', encoding="utf-8"
    )
    (tmp_path / "identknee").chmod(0o755)
    script = _answer([], _IDENTKNEE_COMPLETE="source_bash")
    (tmp_path / "completion.sh").write_text(script, encoding="utf-8")
    asked = (
        f'export PATH="{tmp_path}:$PATH"; . "{tmp_path}/completion.sh"; '
        "COMP_WORDS=(identknee dia); COMP_CWORD=1; _identknee_completion identknee; "
        'echo "${COMPREPLY[@]}"; complete -p identknee'
    )
    said = subprocess.run(
        ["bash", "-c", asked], check=True, capture_output=True, text=True
    ).stdout.splitlines()
    assert said[0] == "diagnose"
    assert "_identknee_completion" in said[1]
