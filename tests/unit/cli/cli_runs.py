"""Verbs run in this process, on a protocol of few trials."""

from pathlib import Path

from typer.testing import CliRunner, Result

from identknee.cli.app import app

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
    result = CliRunner().invoke(app, [str(word) for word in words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


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
