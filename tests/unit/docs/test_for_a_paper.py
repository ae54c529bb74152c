"""The commands and the Python of the page on papers run as they stand, one after the other."""

import re
import shlex
from pathlib import Path

import pytest
from cli_runs import run

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "for_a_paper.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(bash|python)\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


@pytest.mark.usefixtures("few_starts")
def test_all_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for language, code in BLOCKS:
        if language == "python":
            exec(compile(code, "for_a_paper.md", "exec"), {})
            continue
        for line in code.splitlines():
            word, *words = shlex.split(line)
            assert word == "identknee"
            result = run(*words)
            assert result.exit_code == 0, (line, result.output)
    written = {x.name for x in (tmp_path / "results" / "tables").iterdir()}
    assert {"estimates.csv", "estimates.tex", "fit-fitted-parameters.md"} <= written
    assert "compare" in (tmp_path / "results" / "report.html").read_text("utf-8")
    assert (tmp_path / "results" / "both" / "parameters.png").is_file()
    figures = {x.name for x in (tmp_path / "results" / "fit" / "figures").iterdir()}
    assert {"fit-laxity.svg", "fit-laxity.csv"} <= figures
    assert "<text" in (tmp_path / "intervals.svg").read_text("utf-8")
    assert "## profile" in (tmp_path / "results" / "methods.md").read_text("utf-8")
