"""Tables for a paper say what the page says, in three forms."""

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_folders import OPEN_BELOW, profile_folder, straight_profiles

import identknee as ik
from identknee.report.overview import overview
from identknee.report.page.page import report_tables
from identknee.report.presenter import Table, table
from identknee.report.results import found_results
from identknee.report.table_files import (
    FORMS,
    escaped,
    estimates_table,
    forms_of,
    named,
    table_files,
)
from identknee.runs.findings import finding
from identknee.runs.words import label_without_unit

RESULTS = Path(__file__).parents[2] / "fuzz" / "results"
VERBS = sorted(x.name for x in RESULTS.iterdir() if x.name != "check")
NOTE = "It rests on 9 trials & a guess."
HARD = table(
    r"Ends \ of 50 % {x}",
    ["name", ("a_b", None, "N·m"), "note"],
    [["ACL_1 | ~2^", -4.0, "−1 ± 2 µm²"], ["x", 1.5e-7, None], ["#3 & $4", float("nan"), "<1 >0"]],
)


def written(given: Table, form: str, *notes: str) -> str:
    ((_, text),) = table_files({"ends": (given, notes)}, [form])
    return text


def test_a_csv_has_full_precision_and_its_notes_in_comment_lines() -> None:
    given = table("Ends", ["name", ("force", 1, "N")], [["ACL", 1.0 / 3.0], ["PCL", None]])
    lines = written(given, "csv", NOTE).splitlines()
    assert lines[0] == "# Ends"
    assert lines[2] == f"# {NOTE}"
    rows = list(csv.reader(x for x in lines if not x.startswith("#")))
    assert rows == [["name", "force [N]"], ["ACL", repr(1.0 / 3.0)], ["PCL", ""]]
    assert "dash" in lines[1]
    assert "open" in lines[1]


def test_latex_has_nothing_that_it_would_trip_over() -> None:
    text = written(HARD, "latex", NOTE)
    assert text.count("{") - text.count(r"\{") == text.count("}") - text.count(r"\}")
    assert re.findall(r"\\begin\{(\w+)\}", text) == re.findall(r"\\end\{(\w+)\}", text)[::-1]
    body = text.split(r"\hline")[1:4]
    rows = [x for part in body[:2] for x in part.split("\\\\\n") if x.strip()]
    assert len(rows) == 4
    assert all(len(re.findall(r"(?<!\\)&", x)) == 2 for x in rows)
    assert not re.search(r"(?<!\\)[%#_](?!\w*\})", text.replace(r"\label", ""))
    assert text.isascii()
    assert "$-4$" in text
    assert r"$1.5\times 10^{-7}$" in text
    assert r"trials \& a guess" in text


def test_markdown_has_as_many_cells_in_every_line() -> None:
    lines = [x for x in written(HARD, "markdown").splitlines() if x.startswith("|")]
    assert [len(re.findall(r"(?<!\\)\|", x)) for x in lines] == [4] * 5


def test_long_texts_are_broken_in_latex() -> None:
    given = table("t", ["a", "b", ("c", 1)], [["x", "word " * 20, 1.0]])
    assert r"\begin{tabular}{lp{0.25\linewidth}r}" in written(given, "latex")


def test_a_name_comes_from_the_title_and_two_of_one_name_have_numbers() -> None:
    one, other = (table("95 % ends: p = 1", ["a"], [[x]]) for x in ("x", "y"))
    assert list(named([one, other, one, replace(one, rows=())])) == ["ends", "ends-2"]


def test_a_form_that_is_none_is_refused() -> None:
    assert forms_of("csv, latex") == ("csv", "latex")
    with pytest.raises(ValueError, match=r"--tables word\b.* csv, latex, markdown"):
        forms_of("csv,word")


def test_estimates_are_the_numbers_of_the_page() -> None:
    answer = straight_profiles()
    frame = answer.to_dataframe()
    assert list(frame.columns)[:5] == ["quantity", "unit", "estimate", "lower end", "upper end"]
    by_name = frame.set_index("quantity")
    for name, profile in answer.parameters.items():
        row = by_name.loc[label_without_unit(name)]
        assert row["estimate"] == profile.optimum_value
        assert row["upper end"] == profile.upper
    assert np.isnan(by_name.loc[label_without_unit(OPEN_BELOW), "lower end"])
    assert by_name.loc[label_without_unit(OPEN_BELOW), "status"] == "open below"


@pytest.mark.parametrize("verb", VERBS)
def test_every_table_of_a_stored_result_can_be_had(verb: str) -> None:
    answer = ik.load(RESULTS / verb)
    with pytest.raises(ValueError, match="no table") as caught:
        answer.to_dataframe("none")
    # What is offered in its place can be had.
    why = str(caught.value)
    offered = why.partition(" from ")[2].split(", ") if "'none'" in why else []
    for name in offered:
        answer.to_dataframe(name)
    results = found_results(RESULTS / verb)
    found = report_tables(results)
    own_verb = results[0].verb
    start = f"{own_verb}-" if own_verb == verb else f"{verb}-{own_verb}-"
    shown = {x.rstrip("-0123456789") for x in found}
    assert all(re.fullmatch(r"[a-z-]+", x) for x in shown)
    for name, (given, _) in found.items():
        own = name if name == "estimates" else name.removeprefix(start)
        assert len(answer.to_dataframe(own)) == len(given.rows), name
    for name, text in table_files(found, list(FORMS)):
        assert text.endswith("\n"), name
        if name.endswith(".tex"):
            assert text.count(r"\begin{tabular}") == 1


def test_warnings_and_the_proviso_stand_below_the_numbers(tmp_path: Path) -> None:
    profile_folder(tmp_path)
    (result,) = found_results(tmp_path)
    warning = finding("lowest-found-once", "starts", sentence="Only one start ended there.")
    error = finding("no-set-converges", "trials")
    answer = replace(
        result.answer, findings=(warning, error), assumptions=("A; say so with --uncertain x=1.",)
    )
    found = report_tables([replace(result, answer=answer)])
    for name, (_, notes) in found.items():
        assert any("no-set" in x or error.sentence in x for x in notes), name
        assert "A." in notes
        assert "--uncertain" not in " ".join(notes)
    assert overview([answer]).verdict in found["estimates"][1]


def test_a_table_without_rows_is_none() -> None:
    nothing = estimates_table(overview([]))
    assert nothing.rows == ()
    (heads,) = csv.reader(io.StringIO(written(nothing, "csv").partition("\n")[2]))
    assert heads[:5] == ["quantity", "unit", "estimate", "lower end", "upper end"]


def test_letters_that_old_latex_lacks_are_written_in_its_words() -> None:
    assert escaped("−4 ± 1 °, N·m ≤ 2³") == r"$-$4 $\pm$ 1 $^\circ$, N$\cdot$m $\leq$ 2$^3$"
