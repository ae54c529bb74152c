"""The commands and the Python of pages that promise it run as they stand, one after the other."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from cli_runs import run

DOCS = Path(__file__).parents[3] / "docs"
MADE = {
    "for_a_paper": (
        *("results/tables/estimates.csv", "results/tables/estimates.tex"),
        *("results/tables/fit-fitted-parameters.md", "results/both/parameters.png"),
        *("results/fit/figures/fit-laxity.svg", "results/fit/figures/fit-laxity.csv"),
    ),
    "recipes": (
        *("study/tables/estimates.tex", "study/methods.md", "cause/extended/subject.toml"),
        *("plan/advised_trials.csv", "study/profile/figures/profile-intervals.csv"),
        *("intervals.svg", "back/reference.osim", "study/both/result.json"),
    ),
}


@pytest.mark.usefixtures("few_starts")
@pytest.mark.slow
@pytest.mark.parametrize("page", MADE)
def test_all_of_the_page_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for language, code in re.findall(
        r"^```(bash|python)\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    ):
        if language == "python":
            exec(compile(code, f"{page}.md", "exec"), names)
            continue
        for line in code.splitlines():
            word, *words = shlex.split(line)
            assert word == "identknee"
            result = run(*words)
            assert result.exit_code == 0, (line, result.output)
    assert [x for x in MADE[page] if not (tmp_path / x).is_file()] == []
