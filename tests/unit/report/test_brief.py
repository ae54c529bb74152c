"""What a command prints: the answer, its table, three findings at most, and a count of the rest."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from bs4 import BeautifulSoup
from cli_runs import run, short_protocol

from identknee.report.opening import MOST_FINDINGS
from identknee.report.page.page import report_html
from identknee.report.presenter import presenter_of
from identknee.report.printer import brief_lines, terminal_lines
from identknee.report.results import found_results
from identknee.runs.findings import Finding, Severity, finding, without_repeats
from identknee.verbs.answer import Answer
from identknee.verbs.files import load

STORED = Path(__file__).parents[2] / "fuzz" / "results"
VERBS = sorted(x.name for x in STORED.iterdir())
# What the results of a fit to a measured knee may take of a screen.
MOST_LINES = 25


def warnings(n: int) -> tuple[Finding, ...]:
    return tuple(
        finding("trial-against-fit", f"T{k}", sentence=f"T{k} is off the others.") for k in range(n)
    )


def force(ligament: str) -> Finding:
    values = {
        "ligament": ligament,
        "force_N": 1262.0,
        "load": "varus",
        "failure_N": 557.0,
        "source": "Wijdicks 2010",
    }
    return finding("implausible-force", ligament, values)


def error(name: str) -> Finding:
    return finding("broken-convention", name, {"what": name}, sentence=f"{name} is turned.")


NOTE = finding("noise-unstated", "data")


def fit(*findings: Finding) -> Answer:
    return replace(load(STORED / "fit"), findings=findings)


def counted_more(answer: Answer, word: str = "finding") -> int:
    found = re.search(rf"(\d+) {word}s?\b.* more: --verbose", brief_lines(answer)[-1])
    return 0 if found is None else int(found[1])


@pytest.mark.parametrize("n", [0, 1, 3, 4, 9])
def test_three_findings_are_printed_and_the_rest_counted(n: int) -> None:
    given = (NOTE, *warnings(n))
    said = "\n".join(brief_lines(fit(*given)))
    shown = [x for x in given if x.sentence in said]
    assert len(shown) == min(n, MOST_FINDINGS)
    assert NOTE not in shown
    assert counted_more(fit(*given)) == len(given) - len(shown)


@pytest.mark.parametrize("n_errors", [1, 3, 5])
def test_no_error_is_left_out(n_errors: int) -> None:
    errors = tuple(error(f"column {k}") for k in range(n_errors))
    answer = fit(*warnings(4), *errors)
    said = "\n".join(brief_lines(answer))
    assert all(x.line in said for x in errors)
    shown = max(n_errors, MOST_FINDINGS)
    assert counted_more(answer) == 4 + n_errors - shown


def test_what_opens_an_answer_counts_as_said_and_names_one_of_its_kind() -> None:
    answer = fit(force("MCL"), force("LCL"), force("ACL"), *warnings(4))
    said = "\n".join(brief_lines(answer))
    assert "MCL carries 1262" in said.partition(" N")[0]
    assert "LCL carries" not in said
    assert [k for k in range(4) if f"T{k} is off" in said] == [0, 1]
    assert counted_more(answer) == 4
    full = "\n".join(terminal_lines(answer))
    assert all(f"{x} carries 1262 N" in full for x in ("MCL", "LCL", "ACL"))


def test_a_long_finding_is_said_as_its_kind_means_it() -> None:
    long = finding("trial-against-fit", "T0", sentence=f"T0 is off. {'It is far off. ' * 40}")
    said = brief_lines(fit(long))
    (line,) = (x for x in said if "T0" in x)
    assert line == f"Warning: T0: {long.kind.meaning} {long.kind.remedy}"


@pytest.mark.parametrize("verb", VERBS)
def test_a_brief_answer_is_a_part_of_the_whole_one(verb: str) -> None:
    answer = load(STORED / verb)
    whole, brief = terminal_lines(answer), brief_lines(answer)
    if presenter_of(answer).is_brief:
        assert brief == whole
        return
    # All but the count, whose place is last.
    is_counted = brief[-1].endswith("more: --verbose, or the report")
    assert all(x in "\n".join(whole) for x in brief[: len(brief) - is_counted])
    n_findings = len(without_repeats(answer.findings))
    shown = [x for x in answer.findings if any(x.line == y for y in brief)]
    assert counted_more(answer) == n_findings - len(shown)


def test_the_page_has_what_was_counted() -> None:
    answer = fit(NOTE, *warnings(6))
    (result,) = found_results(STORED / "fit")
    page = BeautifulSoup(report_html([replace(result, answer=answer)]), "html.parser").get_text()
    text = " ".join(page.split())
    assert all(x.sentence in text for x in answer.findings)
    assert {x.severity for x in answer.findings} == {Severity.INFO, Severity.WARNING}


def test_verbose_prints_all_and_json_neither(tmp_path: Path) -> None:
    words = ("simulate", "reference", "--protocol", short_protocol(tmp_path))
    assert run(*words, "--out", tmp_path / "data").exit_code == 0
    fitted = ("fit", "reference", tmp_path / "data" / "laxity.csv", "--out", tmp_path / "fit")
    brief, whole = run(*fitted).stdout, run(*fitted, "--verbose").stdout
    answer = load(tmp_path / "fit")
    assert brief.startswith("\n".join(brief_lines(answer)))
    assert whole.startswith("\n".join(terminal_lines(answer)))
    assert "--verbose" not in run(*fitted, "--json").stdout


@pytest.mark.slow
def test_a_fit_to_a_measured_knee_takes_a_screen(tmp_path: Path) -> None:
    result = run("fit", "s192803", "s192803", "--out", tmp_path)
    assert result.output.count("\n") <= MOST_LINES
    page = tmp_path / "report.html"
    assert run("report", tmp_path, "--out", page).exit_code == 0
    text = " ".join(BeautifulSoup(page.read_text(encoding="utf-8"), "html.parser").text.split())
    assert all(" ".join(x.detail.split()) in text for x in load(tmp_path).findings)
