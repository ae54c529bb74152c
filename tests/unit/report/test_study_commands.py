"""Every study is done again by one command, from a clone and nothing else."""

import re
import sys
from pathlib import Path

import pytest
from study_modules import STUDIES, study_module

NAMES = sorted(x.parent.name for x in STUDIES.glob("*/compute.py"))


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """What is run instead of being run; the last one of a study without figures ends with 3."""
    made: list[list[str]] = []

    class Ended:
        returncode = 0

    def run(words: list[str], *, check: bool) -> Ended:
        made.append([Path(words[1]).relative_to(STUDIES).as_posix(), *words[2:]])
        return Ended()

    monkeypatch.setattr("subprocess.run", run)
    return made


@pytest.mark.parametrize("study", NAMES)
def test_a_page_gives_one_command(study: str, calls: list[list[str]]) -> None:
    text = (STUDIES / study / "README.md").read_text(encoding="utf-8")
    commands = re.findall(r"^    (.*python studies/.*?)(?:  +#.*)?$", text, re.MULTILINE)
    assert len(commands) == 1
    words = commands[0].split()
    assert words[:2] == ["python", "studies/run.py"]
    study_module(STUDIES / "run.py").main(words[2:])
    assert calls == [[f"{study}/compute.py", *words[3:]], [f"{study}/figures.py"]]


@pytest.mark.parametrize("study", NAMES)
def test_its_options_are_understood(
    study: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(STUDIES / study)
    monkeypatch.setattr(sys, "argv", ["compute.py", "--help"])
    with pytest.raises(SystemExit) as ended:
        study_module(STUDIES / study / "compute.py").main()
    assert ended.value.code == 0
    assert "--record" in capsys.readouterr().out


def test_a_small_version_leaves_record_and_page_alone(calls: list[list[str]]) -> None:
    study_module(STUDIES / "run.py").main(["03", "--quick"])
    (words,) = calls
    assert words[:3] == ["03_basin_of_attraction/compute.py", "--quick", "--record"]
    assert STUDIES not in Path(words[3]).parents


def test_a_study_that_fails_is_not_drawn(
    monkeypatch: pytest.MonkeyPatch, calls: list[list[str]]
) -> None:
    class Failed:
        returncode = 2

    def fail(words: list[str], *, check: bool) -> Failed:
        calls.append(words)
        return Failed()

    monkeypatch.setattr("subprocess.run", fail)
    with pytest.raises(SystemExit) as ended:
        study_module(STUDIES / "run.py").main(["01"])
    assert ended.value.code == 2
    assert len(calls) == 1


def test_an_unknown_study_is_answered_with_the_list() -> None:
    for name in ("0", "99"):
        with pytest.raises(SystemExit, match=f"{name}.*01_model_evaluation, "):
            study_module(STUDIES / "run.py").main([name])


def test_no_data_from_outside_are_asked_for() -> None:
    """By the variable that once named a folder of data which only some had."""
    root, word = STUDIES.parent, "IDENTKNEE_" + "SHARED"
    files = list((root / ".ci").glob("*"))
    for folder in ("identknee", "studies", "tests"):
        files += [x for kind in ("py", "md") for x in (root / folder).rglob(f"*.{kind}")]
    assert [x for x in files if word in x.read_text(encoding="utf-8")] == []
