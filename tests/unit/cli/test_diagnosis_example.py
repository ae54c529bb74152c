"""The example of a hidden cause prints what the page on diagnoses shows."""

import re
from pathlib import Path

import pytest
from cli_runs import run

PAGE = Path(__file__).parents[3] / "docs" / "diagnosis.md"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
# Of the last digit shown: another rounding, and no more.
LAST_DIGIT = 1.001


def shown() -> dict[str, list[str]]:
    """Each command of the example with the lines below it, those left out as ``...``."""
    text = PAGE.read_text(encoding="utf-8")
    (block,) = re.findall(r"```console\n(.*?)```", text, re.DOTALL)
    parts: dict[str, list[str]] = {}
    for line in block.splitlines():
        if line.startswith("$ identknee "):
            lines = parts[line.removeprefix("$ identknee ")] = []
        else:
            lines.append(line)
    return parts


def is_alike(line: str, printed: str) -> bool:
    """Whether both have the same words, and numbers that agree in the digits shown."""
    if NUMBER.split(line) != NUMBER.split(printed):
        return False
    return all(
        abs(float(x) - float(y)) <= LAST_DIGIT * 10.0 ** -len(x.partition(".")[2])
        for x, y in zip(NUMBER.findall(line), NUMBER.findall(printed), strict=True)
    )


@pytest.mark.slow
def test_every_line_of_the_example_is_printed_in_its_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    commands = shown()
    assert [x.split()[0] for x in commands] == ["blind", "diagnose", "reveal"]
    for command, lines in commands.items():
        result = run(*command.split())
        assert result.exit_code == 0, result.output
        left = [x for x in result.stdout.splitlines() if x]
        for line in (x for x in lines if x.strip() not in ("...", "")):
            places = [i for i, x in enumerate(left) if is_alike(line, x)]
            assert places, f"the page shows {line!r}, which is not printed in this place"
            del left[: places[0] + 1]


def test_lines_differ_in_words_and_in_digits_shown() -> None:
    assert is_alike("x 1.15 kN", "x 1.16 kN")
    assert not is_alike("x 1.15 kN", "x 1.17 kN")
    assert not is_alike("x 1.15 kN", "x 1.15 mm")
    assert not is_alike("x 1.15 kN", "x 1.15 kN, 3")
