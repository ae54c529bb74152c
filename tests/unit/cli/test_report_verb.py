"""`identknee report`: one page from whatever results there are."""

import json
import re
import shutil
from pathlib import Path

import pytest
from cli_runs import refused, run, short_protocol, summary_in

from identknee.report.table_files import FORMS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulation with noise and a fit to it, in two folders."""
    whole = tmp_path_factory.mktemp("story")
    protocol = short_protocol(whole)
    words = ["--protocol", protocol, "--noise", "0.3mm,0.3deg", "--out", whole / "simulate"]
    assert run("simulate", "reference", *words).exit_code == 0
    data = whole / "simulate" / "laxity.csv"
    assert run("fit", "reference", data, "--out", whole / "fit").exit_code == 0
    return whole


def test_it_takes_what_it_finds(folder: Path) -> None:
    result = run("report", folder, "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert [x["verb"] for x in summary["results"]] == ["simulate", "fit"]
    assert summary["remarks"] == summary["figures"] == []
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert summary["report"] == str(folder / "report.html")
    assert "best fit" in page
    # The library of the three-dimensional knee, once.
    assert page.count("plotly.js v") == 1
    assert page.count('class="knee-viewer"') == 1


@pytest.mark.slow
def test_figures_for_a_paper_lie_beside_the_page(folder: Path, tmp_path: Path) -> None:
    result = run("report", folder / "fit", "--out", tmp_path / "page.html", "--figures", "pdf")
    assert result.exit_code == 0, result.output
    assert f"4 figures: {tmp_path / 'figures'}" in result.stdout
    files = sorted((tmp_path / "figures").iterdir())
    assert [x.name for x in files] == [
        "fit-all-forces.pdf",
        "fit-knee-loads.pdf",
        "fit-laxity-all.pdf",
        "fit-laxity.pdf",
    ]
    assert all(x.read_bytes().startswith(b"%PDF") for x in files)


@pytest.mark.usefixtures("no_drawings")
def test_tables_and_methods_lie_beside_the_page(folder: Path, tmp_path: Path) -> None:
    page = ("--out", tmp_path / "page.html")
    result = run("report", folder, *page, "--tables", "csv,latex", "--methods")
    assert result.exit_code == 0, result.output
    names = {x.name for x in (tmp_path / "tables").iterdir()}
    tables = ("fit-fitted-parameters", "simulate-largest-ligament-forces")
    assert names == {f"{x}.{form}" for x in tables for form in ("csv", "tex")}
    (line,) = [x for x in result.stdout.splitlines() if x.endswith(str(tmp_path / "tables"))]
    assert re.findall(r"\b\d+\b", line.removesuffix(str(tmp_path / "tables"))) == ["4"]
    text = (tmp_path / "methods.md").read_text(encoding="utf-8")
    assert [x for x in text.splitlines() if x.startswith("#")] == [
        *("# Methods", "## simulate (simulate)", "## fit (fit)")
    ]
    said = refused("report", folder, *page, "--tables", "odt")
    assert re.findall("odt|csv|latex|markdown", said) == ["odt", *FORMS]


@pytest.mark.slow
def test_a_subject_that_is_gone_is_reported_without_its_knee(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "fit", tmp_path, dirs_exist_ok=True)
    kept = summary_in(folder / "fit")
    for subject, why in ((str(tmp_path / "gone"), "gone"), ("reference", "has changed since")):
        kept["record"]["settings"]["subject"] = subject
        kept["record"]["inputs"]["subject"] = "0" * 64
        (tmp_path / "result.json").write_text(json.dumps(kept), encoding="utf-8")
        result = run("report", tmp_path)
        assert result.exit_code == 0, result.output
        assert "not shown" in result.stdout
        assert why in result.stdout
        assert "Plotly" not in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("no_drawings")
@pytest.mark.slow
def test_a_subject_called_uncertain_is_the_same_subject(folder: Path, tmp_path: Path) -> None:
    table = folder / "simulate" / "laxity.csv"
    stated = ("--uncertain", "contact_modulus=0.3", "--out", tmp_path)
    assert run("information", "reference", table, "--noise", "1mm,1deg", *stated).exit_code == 0
    result = run("report", tmp_path)
    assert result.exit_code == 0, result.output
    assert "not shown" not in result.stdout


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    assert "no results" in refused("report", tmp_path)
    assert "nowhere: there" in refused("report", tmp_path / "nowhere")
