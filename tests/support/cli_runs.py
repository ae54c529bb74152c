"""Verbs run in this process, on a protocol of few trials."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

from typer.testing import CliRunner, Result

import identknee as ik
from identknee.cli.app import app
from identknee.runs.declare import entries
from identknee.runs.schema import to_plain
from identknee.verbs.answer import Answer

UNFORESEEN = "this should not have happened"
_READ_SUBJECT = ik.read_subject
SHORT_PROTOCOL = """
format = 1
name = "short"
[[ramps]]
flexion_deg = [0, 30]
load = "internal_moment_Nm"
values = [-4, 0, 4]
[[ramps]]
flexion_deg = [0, 30]
load = "varus_moment_Nm"
values = [-4, 4]
"""


def run(*words: object) -> Result:
    """Result of the command with these words; what is no exit is raised."""
    with (
        patch.object(ik, "read_subject", _read_subject),
        patch("identknee.verbs.verb.read_subject", _read_subject),
    ):
        result = CliRunner().invoke(app, [str(word) for word in words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert UNFORESEEN not in result.stderr, result.stderr
    return result


def _read_subject(subject: str) -> ik.Knee:
    return _reference() if subject == "reference" else _READ_SUBJECT(subject)


@cache
def _reference() -> ik.Knee:
    """The same knee for every run, whose maps of the surfaces are then made once."""
    return _READ_SUBJECT("reference")


def summary_in(folder: Path) -> dict[str, Any]:
    """What a verb left in its `result.json`."""
    content: dict[str, Any] = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    return content


def refused(*words: object) -> str:
    """The sentence a command is refused with: exit code 2, one line, no traceback."""
    result = run(*words)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("identknee: ")
    assert result.stderr.count("\n") == 1
    return result.stderr.removeprefix("identknee: ").strip()


def short_protocol(folder: Path) -> Path:
    """File of a protocol of ten trials, in `folder`."""
    path = folder / "short.toml"
    path.write_text(SHORT_PROTOCOL, encoding="utf-8")
    return path


def said(answer: Answer) -> str:
    """All that files hold of an answer but when it was made, as text: NaN differs from itself."""
    kept = entries(type(answer)).items()
    alone: dict[str, Any] = {name: None for name, about in kept if not about.is_in_files}
    return json.dumps(without_times(to_plain(replace(answer, record=None, **alone))))


def without_times(plain: Any) -> Any:
    if isinstance(plain, list):
        return [without_times(x) for x in plain]
    if not isinstance(plain, dict):
        return plain
    return {name: without_times(x) for name, x in plain.items() if "seconds" not in name}
