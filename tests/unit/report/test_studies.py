"""The studies draw from their committed records, and their pages are up to date."""

import json
import sys
from pathlib import Path
from types import ModuleType

import pytest
from figure_checks import clipped, code_names, drawn, empty_axes, overlapping
from matplotlib.figure import Figure
from slow_cases import some_slow
from study_modules import STUDIES, study_module

from identknee.subject.examples import NAMED_SUBJECTS

# Named in figures as the user names them.
SUBJECTS = (*(x.name for x in NAMED_SUBJECTS), "lenhart2015_bundles")
PAPER = "13_paper"  # draws a page of the documentation, and has a test of its own
NAMES = sorted({x.parent.name for x in STUDIES.glob("*/compute.py")} - {PAPER})
SLOW = (
    *("02_initial_guess", "03_basin_of_attraction", "04_profiles", "05_posterior"),
    *("07_global_sensitivity", "12_geometry_uncertainty"),
)
LARGEST_RECORD = 1_000_000  # bytes


def load(study: str, name: str) -> ModuleType:
    return study_module(STUDIES / study / f"{name}.py")


@pytest.mark.parametrize("study", some_slow(NAMES, SLOW))
def test_figures_are_drawn_from_the_committed_record(
    study: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A script finds the modules beside it.
    monkeypatch.syspath_prepend(STUDIES / study)
    module = load(study, "figures")
    figures: list[Figure] = []

    def kept(figure: Figure) -> bytes:
        figures.append(figure)
        return b""

    monkeypatch.setattr(sys.modules["common.page"], "png", kept)
    page = tmp_path / "README.md"
    page.write_text((STUDIES / study / "README.md").read_text(encoding="utf-8"), encoding="utf-8")
    out = tmp_path / "figures"
    monkeypatch.setattr(sys, "argv", ["figures.py", "--out", str(out), "--page", str(page)])
    module.main()
    committed = {x.name for x in (STUDIES / study / "figures").iterdir()}
    assert {x.name for x in out.iterdir()} == committed
    assert page.read_text(encoding="utf-8") == (STUDIES / study / "README.md").read_text(
        encoding="utf-8"
    )
    for figure in figures:
        renderer = drawn(figure)
        assert empty_axes(figure, renderer) == []
        assert clipped(figure, renderer) == []
        assert overlapping(figure, renderer) == []
        assert code_names(figure, SUBJECTS) == []


@pytest.mark.parametrize("study", NAMES)
def test_records_are_small_and_say_how_they_were_made(study: str) -> None:
    for path in (STUDIES / study / "records").iterdir():
        assert path.stat().st_size < LARGEST_RECORD
        record = json.loads(path.read_text(encoding="utf-8"))
        assert record["head"]["command"].startswith(f"python studies/{study}/compute.py")
        assert record["head"]["commit"]
        assert set(record["head"]["inputs"]) == set(record["knees"])


@pytest.mark.parametrize("study", NAMES)
def test_every_picture_on_a_page_is_there(study: str) -> None:
    text = (STUDIES / study / "README.md").read_text(encoding="utf-8")
    for name in (STUDIES / study / "figures").iterdir():
        assert f"(figures/{name.name})" in text


def test_a_study_is_computed_from_the_package_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = load("01_model_evaluation", "compute")
    monkeypatch.setattr(module, "KNEES", ("reference", "lenhart2015_stable"))
    monkeypatch.setattr(module, "RAMPS", (("varus_moment_Nm", 1.0, 0.5),))
    monkeypatch.setattr(module, "RAMP_FLEXION_DEG", (0.0,))
    path = tmp_path / "record.json"
    monkeypatch.setattr(sys, "argv", ["compute.py", "--record", str(path), "--workers", "1"])
    module.main()
    record = json.loads(path.read_text(encoding="utf-8"))
    assert list(record["knees"]) == ["reference", "lenhart2015_stable"]
    for name, part in record["knees"].items():
        assert part["seed63"]["outcomes"] == {"converged": 63}, name


def test_fits_are_kept_and_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = load("02_initial_guess", "compute")
    monkeypatch.setattr(module, "KNEES", ("reference",))
    arguments = ["--seeds", "1", "--budget", "25", "--box-samples", "1", "--workers", "1"]
    paths = ["--store", str(tmp_path / "store.sqlite"), "--record", str(tmp_path / "record.json")]
    monkeypatch.setattr(sys, "argv", ["compute.py", *arguments, *paths])
    module.main()
    first = json.loads((tmp_path / "record.json").read_text(encoding="utf-8"))
    assert list(first["knees"]) == ["reference"]
    assert first["counts"]["fits"] == 8
    exact = first["knees"]["reference"]["least-squares"]
    assert max(max(row["error_kN"] + row["error_pct"]) for row in exact) < 1e-6

    def made_again(_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(module, "fit_row", made_again)
    module.main()
    second = json.loads((tmp_path / "record.json").read_text(encoding="utf-8"))
    assert second["knees"] == first["knees"]
