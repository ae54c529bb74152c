"""What the README shows is true: its commands, its Python and its tables."""

import re
import tomllib
from pathlib import Path

import pytest

import identknee as ik

ROOT = Path(__file__).parents[2]


def blocks(language: str) -> list[str]:
    """The README's code blocks in a language."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def test_two_commands_do_all_set_up() -> None:
    first, second = blocks("bash")
    for command in (first, second):
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install")
        assert command.count("\n") == 1
    assert first.endswith("identknee demo\n")
    # `.ci/run` finds its test command by these words.
    assert "-m pytest" in second
    assert "-m pytest" not in first
    assert "grep -m 1 -- '-m pytest' README.md" in (ROOT / ".ci" / "run").read_text("utf-8")


@pytest.mark.usefixtures("few_starts", "no_drawings")
def test_the_python_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = blocks("python")
    assert code.count("\n") <= 10
    exec(compile(code, "README.md", "exec"), {})
    said = capsys.readouterr().out
    assert "ACL stiffness [kN]" in said
    assert "minimum" in said
    assert (tmp_path / "identknee-report" / "report.html").is_file()


def test_the_laxity_table_can_be_read(tmp_path: Path) -> None:
    (table,) = blocks("text")
    (tmp_path / "data.csv").write_text(table, encoding="utf-8")
    laxity = ik.read_laxity(tmp_path / "data.csv")
    assert laxity.protocol.trials == ("a", "b")
    assert int(laxity.is_measured.sum()) == 9


def test_the_subject_has_the_form_that_is_written(tmp_path: Path) -> None:
    (text,) = blocks("toml")
    shown = tomllib.loads(text)
    ik.write_subject(ik.reference_knee(edge_mm=4.0), tmp_path)
    written = tomllib.loads((tmp_path / "subject.toml").read_text(encoding="utf-8"))
    assert shown["format"] == written["format"]
    assert set(shown["surfaces"]) == set(written["surfaces"])
    assert set(shown["ligaments"][0]) == set(written["ligaments"][0])


@pytest.mark.parametrize(
    "name", ["README.md", "CONTRIBUTING.md", "tests/README.md", "docs/diagnosis.md"]
)
def test_every_file_named_in_a_page_is_there(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    paths = re.findall(r"`((?:identknee|tests)/[\w/]+\.py|(?:identknee|tests)/[\w/]+/)`", text)
    for path in paths:
        if "VERB" in path:  # stands for a name
            continue
        assert (ROOT / path).exists(), path
