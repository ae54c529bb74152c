"""The page of the paper is up to date with the records, and takes no number from elsewhere."""

import json
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
from common.published import TABLE2

from identknee.report.presenter import Table

ROOT = Path(__file__).parents[3]
STUDY = ROOT / "studies" / "13_paper"
PAGE = ROOT / "docs" / "paper.md"
MODULES = ("other_studies", "page_tables", "beyond_tables", "page_numbers", "figures", "compute")
# Titles of the paper's tables and figures, each with a section of the page.
SECTIONS = (*(f"## Table {i}:" for i in range(1, 6)), "## Tables 6 and 7:")
SECTIONS += tuple(f"## Figure {i}:" for i in range(1, 5))
VERDICT = re.compile(r"\*\*(Agrees|Differs|Cannot be compared)\.?\*\*")


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    # A script finds the modules beside it; their names are other studies' too.
    monkeypatch.syspath_prepend(STUDY)
    for name in MODULES:
        sys.modules.pop(name, None)
    yield import_module("figures")
    for name in MODULES:
        sys.modules.pop(name, None)


def test_the_page_is_up_to_date_with_the_records(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = PAGE.read_text(encoding="utf-8")
    page = tmp_path / "paper.md"
    page.write_text(text, encoding="utf-8")
    out = tmp_path / "paper"
    monkeypatch.setattr(sys, "argv", ["figures.py", "--out", str(out), "--page", str(page)])
    script.main()
    assert page.read_text(encoding="utf-8") == text
    drawn = {x.name for x in out.iterdir()}
    assert drawn == {x.name for x in (PAGE.parent / "paper").iterdir()}
    assert all(f"(paper/{name})" in text for name in drawn)


def test_every_table_and_figure_of_the_paper_has_a_verdict() -> None:
    text = PAGE.read_text(encoding="utf-8")
    parts = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    for section in SECTIONS:
        (part,) = [x for x in parts if x.startswith(section)]
        assert VERDICT.search(part), section


def test_every_picture_and_link_of_the_page_is_there() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        # The documentation writes its studies' pages from the folder of that name.
        folder = ROOT if target.startswith("studies/") else PAGE.parent
        assert target == "studies/index.md" or (folder / target).exists(), target


def test_what_has_no_record_says_so_in_one_line(script: ModuleType) -> None:
    nothing = dict.fromkeys(script.SOURCES)
    made = {**script.tables(nothing), **script.beyond(nothing)}
    lines = [x for x in made.values() if not isinstance(x, Table)]
    # One table needs the paper's own numbers only.
    assert len(lines) == len(made) - 1
    assert all(x.count("\n") == 0 and "`python studies/" in x for x in lines)
    text = "Up to <!--=check_small_force-->18<!--/--> N, <!--=basin_ends-->5<!--/--> ends."
    text = script.with_numbers(text, script.numbers(nothing))
    assert re.fullmatch(r"Up to (\(.*?\)) N, \1 ends\.", re.sub(r"<!--.*?-->", "", text))


def test_a_number_that_nothing_computes_and_a_hidden_line_are_errors(script: ModuleType) -> None:
    found = {study: script.record_of(study) for study in script.SOURCES}
    text_of = script.numbers(found)
    with pytest.raises(ValueError, match="'check_nothing'"):
        script.with_numbers("It is <!--=check_nothing--><!--/--> N.", text_of)
    with pytest.raises(ValueError, match="the mark"):
        script.with_numbers("  <!--=check_small_force--><!--/--> N", text_of)


def test_numbers_of_the_page_are_those_of_the_records(script: ModuleType) -> None:
    """Some of them, counted again in another way."""
    found = {study: script.record_of(study) for study in script.SOURCES}
    text_of = script.numbers(found)
    near = sum(abs(x.paper_model - x.mean) <= x.sd for x in TABLE2)
    assert text_of("laxity_within_paper") == str(near)
    checks = json.loads((STUDY / "records" / "paper_checks.json").read_text(encoding="utf-8"))
    forces = [
        force
        for part in checks["knees"].values()
        for row in part["small_errors"]["tension_by_flexion_N"]
        for force in row
    ]
    # The trials of all angles are those of all scenarios.
    assert text_of("check_small_force") == f"{max(forces):.0f}"


def test_the_record_says_how_it_was_made() -> None:
    record = json.loads((STUDY / "records" / "paper_checks.json").read_text(encoding="utf-8"))
    assert record["head"]["command"] == "python studies/13_paper/compute.py"
    assert record["head"]["commit"]
    assert set(record["head"]["inputs"]) == set(record["knees"])


def test_checks_are_computed_anew(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """With few draws and short searches, beside the committed record where they must agree."""
    module = import_module("compute")
    monkeypatch.setattr(module, "CHECKPOINTS", (20, 30))
    tasks = [("reference", start, 0) for start in ("IG1", "IG4")]
    near, far = (module.one_course(task) for task in tasks)
    assert near["error_kN"][-1] < far["error_kN"][-1]
    assert len(near["error_kN"]) == 2
    small = module.small_errors("reference", 2)
    assert small["n_without_prediction"] == 0
    committed = json.loads((STUDY / "records" / "paper_checks.json").read_text(encoding="utf-8"))
    part = committed["knees"]["reference"]
    assert max(map(max, small["tension_by_flexion_N"])) <= max(
        map(max, part["small_errors"]["tension_by_flexion_N"])
    )
    unfitted = module.before_any_fit("reference")
    assert unfitted["IG4"]["rmse_deg"] == pytest.approx(part["before_any_fit"]["IG4"]["rmse_deg"])
    assert module.smallest_step("reference") == pytest.approx(part["smallest_step"])
    assert min(part["smallest_step"].values()) > 0.0
