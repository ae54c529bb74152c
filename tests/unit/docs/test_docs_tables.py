"""What the pages say beside the code, its records and files is true, and their links lead on."""

import importlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import identknee as ik
from identknee.identify.profile.result import ProfileVerdict
from identknee.laxity.protocol import (
    BUILT_IN,
    FLEXION,
    FLEXION_DEG,
    LOADS,
    WAYS,
    candidate_trials,
)
from identknee.laxity.table import COORDINATES, PHASES
from identknee.report.answers.profile import PROFILE_WORDS
from identknee.report.presenter import open_ends_text
from identknee.runs.findings import KINDS
from identknee.verbs.registry import verbs

ROOT = Path(ik.__file__).parents[1]
DOCS, PACKAGE = ROOT / "docs", ROOT / "identknee"
DOI = re.compile(r"10\.\d{4,5}/[\w().;:/-]*\w")
RECORDS = ("verification/verdict.json", "benchmarks/record.json")


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module that writes pages, by the name of its part."""
    monkeypatch.syspath_prepend(str(DOCS))
    return lambda part: importlib.import_module(f"pages.{part}")


def page(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def test_every_line_that_was_measured_is_shown_the_missed_ones_first(
    pages: Any, tmp_path: Path
) -> None:
    pages("records").write_records(tmp_path / "records.md", ROOT / "tests")
    text = (tmp_path / "records.md").read_text(encoding="utf-8")
    rows: dict[str, Any] = {}
    for name in RECORDS:
        rows |= json.loads((ROOT / "tests" / name).read_text(encoding="utf-8"))["rows"]
    shown = re.findall(r"^## (\w+): (\w+)$", text, re.MULTILINE)
    assert {name: row["verdict"] for name, row in rows.items()} == dict(shown)
    assert len(shown) == len(rows)
    verdicts = [verdict for _, verdict in shown]
    assert verdicts == sorted(verdicts, key=["missed", "met", "reported"].index)
    measures = [x for row in rows.values() for x in row["measures"]]
    table = [line for line in text.splitlines() if line.startswith("| ")]
    for met, mark in ((True, "| yes |"), (False, "| **missed** |")):
        wanted = sum(x["met"] is met for x in measures)
        assert sum(line.endswith(mark) for line in table) == wanted
    for row in rows.values():
        assert row["commit"] in text
        assert row["date"] in text


def test_an_unknown_number_is_no_number(pages: Any) -> None:
    number = pages("records").number
    assert [number(x) for x in (None, float("nan"), float("inf"), 3.0, 0.012345, 123456.7)] == [
        *("none", "none", "infinity", "3", "0.0123", "123,457")
    ]


def test_every_public_name_and_package_has_its_place(pages: Any) -> None:
    packages = {x.parent.name for x in PACKAGE.glob("*/__init__.py")}
    assert set(pages("api").PACKAGES) == packages - {"cli"}
    listed = pages("api").index_page()
    for name in set(dir(ik)) - packages:
        assert f".{name}\n" in listed
        home = getattr(ik, name).__module__
        assert f".. automodule:: {home}\n" in pages("api").package_page(home.split(".")[1])


def test_the_boxes_of_the_flow_lead_somewhere(pages: Any) -> None:
    flow = pages("flow")
    drawn = flow.drawing(flow.ROW, "wide") + flow.drawing(1, "narrow")
    for link in re.findall(r'href="([^"]+)\.html"', drawn):
        folder, name = link.split("/")
        if folder == "api":
            assert name in pages("api").PACKAGES
        else:
            assert (DOCS / "tutorials" / f"{name}.py").exists()
    assert [x.name for x in flow.STAGES] == [
        *("subject", "laxity", "model", "calibrate", "identify", "diagnose", "report")
    ]


def test_every_command_has_its_help(pages: Any, tmp_path: Path) -> None:
    pages("commands").write_commands(tmp_path / "commands.md")
    text = (tmp_path / "commands.md").read_text(encoding="utf-8")
    shown = re.findall(r"^## identknee ?(.*)$", text, re.MULTILINE)
    commands = {x.name for x in verbs() if x.summary}
    assert set(shown) == commands | {"", "subject list", "doctor", "report", "reveal"}
    assert text.count("Usage: identknee") == len(shown)


def test_every_kind_of_finding_is_on_its_page_with_what_to_do(pages: Any, tmp_path: Path) -> None:
    pages("findings").write_findings(tmp_path / "findings.md")
    text = (tmp_path / "findings.md").read_text(encoding="utf-8")
    codes = re.findall(
        r"^\| `([a-z-]+)` \| (\w+)(, nothing holds)? \| (.*) \| (.*) \|$", text, re.M
    )
    assert [x[0] for x in codes] == list(KINDS)
    for code, severity, ends, meaning, remedy in codes:
        kind = KINDS[code]
        assert (severity, bool(ends)) == (kind.severity.value, kind.invalidates)
        assert (meaning, remedy) == (kind.meaning, kind.remedy)
    assert "{include} _parts/findings.md" in page("findings.md")


def test_theory_names_what_there_is_and_every_function_leads_back(pages: Any) -> None:
    sections = pages("theory").sections_by_name(DOCS / "theory.md")
    assert len(sections) > 40
    for name in sections:
        module, _, last = name.rpartition(".")
        assert hasattr(importlib.import_module(module), last), name
    lines: list[str] = []
    hook = pages("theory").way_back(DOCS / "theory.md")
    hook(None, "function", "identknee.mechanics.elements.tension", None, None, lines)
    assert any("theory-ligament" in line for line in lines)


def test_sources_of_the_theory_are_those_of_the_docstrings() -> None:
    code = "".join(x.read_text(encoding="utf-8") for x in PACKAGE.rglob("*.py"))
    cited = set(DOI.findall(page("theory.md").replace(")](https", ") (https")))
    assert len(cited) > 15
    assert {x for x in cited if x.rstrip(").,") not in code} == set()


def test_columns_of_the_laxity_table_are_those_that_are_read() -> None:
    text = page("conventions.md").split("## Laxity table")[1].split("\n## ")[0]
    named = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\|([^|]+)\|", text, re.MULTILINE))))
    first = f"sd_{COORDINATES[0]}"
    assert named == {"trial", FLEXION, *LOADS, *COORDINATES, first, "order", "phase"}
    assert all(f"`{phase}`" in text for phase in PHASES)


def test_the_glossary_has_every_verdict_of_a_profile_as_it_is_shown() -> None:
    text = page("glossary.md").split("**Verdict of a profile.**")[1].split("\n**")[0]
    rows = dict(re.findall(r"^\| `(\w+)` \| ([^|]+) \|", text, re.MULTILINE))
    assert list(rows) == [x.value for x in ProfileVerdict]
    open_ends = ", ".join(open_ends_text(*x) for x in ((1.0, None), (None, 1.0)))
    for verdict in ProfileVerdict:
        assert rows[verdict.value] == PROFILE_WORDS.get(verdict, open_ends)


def test_extras_are_those_that_can_be_installed() -> None:
    text = page("quick_start.md").split("## Extras")[1]
    named = set(re.findall(r"^\| `(\w+)`(?:, `(\w+)`)? \|", text, re.MULTILINE))
    extras = {x for pair in named for x in pair if x}
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    table = settings.split("[project.optional-dependencies]")[1].split("\n[")[0]
    assert extras == set(re.findall(r"^(\w+) = ", table, re.MULTILINE))


def test_every_study_gets_a_page_without_a_picture_that_is_not_there(
    pages: Any, tmp_path: Path
) -> None:
    study = tmp_path / "studies" / "01_question"
    (study / "records").mkdir(parents=True)
    text = "# Why?\n\n![Because](figures/figure_1.png)\n\n[all](records/record.json)\n"
    (study / "README.md").write_text(text, encoding="utf-8")
    pages("studies").write_studies(tmp_path / "pages", tmp_path / "studies")
    made = (tmp_path / "pages" / "01_question" / "README.md").read_text(encoding="utf-8")
    assert "*Because: " in made
    assert "`records/record.json`" in made
    listed = (tmp_path / "pages" / "index.md").read_text(encoding="utf-8")
    assert "01_question/README" in listed


def test_built_in_protocols_are_as_the_page_says() -> None:
    text = page("conventions.md").split("## Protocols")[1].split("Each has one unloaded")[0]
    said: dict[str, list[list[str]]] = {}
    for line in text.splitlines():
        cells = [x.strip() for x in line.strip("| ").split(" | ")]
        if found := re.match(r"\| `(\w+)` \|", line):
            said[found[1]] = [cells[1:]]
        elif line.startswith("| | |"):
            next(reversed(said.values())).append(["", *cells[-3:]])
    assert tuple(said) == BUILT_IN
    for name, rows in said.items():
        protocol = ik.load_protocol(name)
        assert int(rows[0][0]) == protocol.n
        assert (np.count_nonzero(protocol.loads, axis=1) <= 1).all()
        assert int(protocol.is_unloaded.sum()) == np.unique(protocol.flexion_deg).size
        for way, (positive, negative, kind) in enumerate(WAYS):
            for word, sign in ((positive, 1.0), (negative, -1.0)):
                is_own = sign * protocol.loads[:, way] > 0.0
                own = [x for x in rows if re.search(rf"\b{word}\b", x[1])]
                angles = {float(y) for x in own for y in x[2].split(", ")}
                assert angles == set(protocol.flexion_deg[is_own]), (name, word)
                if own:
                    unit = "N·m" if kind == "moment" else "N"
                    largest = np.abs(protocol.loads[is_own, way]).max()
                    assert f"{largest:g} {unit}" in own[0][1], (name, word)
    usual = candidate_trials(ik.load_protocol("drawer"), [90.0])
    assert int((usual.flexion_deg == 90.0).sum()) == 23
    assert tuple(range(0, 121, 15)) == FLEXION_DEG


def test_the_protocol_of_the_page_is_read_as_it_says(tmp_path: Path) -> None:
    text = page("conventions.md")
    (block,) = re.findall(r"## Protocols\n.*?```toml\n(.*?)```", text, re.DOTALL)
    (tmp_path / "mine.toml").write_text(block, encoding="utf-8")
    found = ik.load_protocol(tmp_path / "mine.toml")
    assert found.n == 2 * 3 + 1
    assert found.state == ("intact",) * 6 + ("cut: ACL",)
    assert (found.loads[:6, LOADS.index("distraction_force_N")] == -50.0).all()
    pivot = dict(zip(LOADS, found.loads[-1].tolist(), strict=True))
    assert (found.trials[-1], found.flexion_deg[-1]) == ("pivot", 20.0)
    assert {k for k, x in pivot.items() if x} == {"varus_moment_Nm", "internal_moment_Nm"}


@pytest.mark.parametrize("tutorial", sorted(x.name for x in (DOCS / "tutorials").glob("*.py")))
def test_a_tutorial_ends_in_a_file_that_a_reader_keeps(tutorial: str) -> None:
    text = page(f"tutorials/{tutorial}")
    code = [x for x in text.partition('"""\n\n')[2].splitlines() if x and not x.startswith("#")]
    writes = r"\.(savefig|to_csv|write_text|write_subject|export_subject|report)\("
    assert re.search(writes, "\n".join(code[-25:])), tutorial
