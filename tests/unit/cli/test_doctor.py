"""`identknee doctor`, on a sound installation and on broken ones."""

import json
import re
from importlib.metadata import PackageNotFoundError
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import run
from typer.testing import Result

import identknee as ik
from identknee.verbs import installation

ROOT = Path(__file__).parents[3]


class _Installed:
    """What the metadata of an installation say."""

    version = "0.1.0"

    def __init__(self, *requires: str, python: str = ">=3.11") -> None:
        self.requires = list(requires)
        self.metadata = self
        self._python = python

    def __getitem__(self, _: str) -> str:
        return self._python

    def get_all(self, _: str) -> list[str]:
        return ["cluster", "lint"]


def _installed(monkeypatch: pytest.MonkeyPatch, *requires: str, python: str = ">=3.11") -> None:
    monkeypatch.setattr(
        installation, "distribution", lambda _: _Installed(*requires, python=python)
    )


def _lines(result: Result, name: str) -> str:
    (line,) = [x for x in result.stdout.splitlines() if f"  {name}: " in x]
    return line.strip()


def test_all_is_sound_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, "numpy>=1.26", "numba>=0.61")
    result = run("doctor")
    assert result.exit_code == 0, result.output
    assert "FAIL" not in result.stdout
    assert result.stdout.endswith(" passed.\n")
    for name in ("Python", "numpy", "cores", "folder", "poses", "derivatives", "fit"):
        assert _lines(result, name).startswith("ok")


def test_the_checks_as_json(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, "numpy>=1.26")
    summary = json.loads(run("doctor", "--json").stdout)
    made = ik.verbs.doctor()
    assert summary["is_sound"] is made.is_sound is True
    named = [(x["group"], x["name"]) for x in summary["checks"]]
    assert named == [(x.group, x.name) for x in made.checks]
    groups = list(dict.fromkeys(x["group"] for x in summary["checks"]))
    assert groups == ["versions", "machine", "cache", "extras", "self-test"]
    assert set(summary["checks"][0]) == {"group", "name", "is_sound", "found", "remedy"}


@pytest.mark.parametrize(
    ("requirement", "found", "remedy"),
    [
        ("numpy>=99", ", but >=99 is needed", "Install it: pip install 'numpy>=99'"),
        ("no-such-package>=2", "not installed", "Install it: pip install 'no-such-package>=2'"),
    ],
)
def test_a_package_that_is_missing_or_old_is_named_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, requirement: str, found: str, remedy: str
) -> None:
    _installed(monkeypatch, requirement)
    result = run("doctor")
    assert result.exit_code == 1
    line = _lines(result, requirement.partition(">")[0])
    assert line.startswith("FAIL")
    assert found in line
    assert line.endswith(remedy)
    assert result.stderr.count("\n") == 1
    assert "1 of" in result.stderr
    assert requirement.partition(">")[0] in result.stderr


def test_another_python_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, python=">=99")
    result = run("doctor")
    assert result.exit_code == 1
    assert "Python >=99" in _lines(result, "Python")


def test_sources_that_are_not_installed_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> Any:
        raise PackageNotFoundError

    monkeypatch.setattr(installation, "distribution", missing)
    result = run("doctor")
    assert result.exit_code == 1
    assert _lines(result, "identknee").endswith(": pip install .")


def test_a_cache_that_cannot_be_written_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _installed(monkeypatch)
    place = tmp_path / "cache"
    place.write_text("a file", encoding="utf-8")
    monkeypatch.setattr(installation, "cache_folder", lambda: place)
    result = run("doctor")
    assert result.exit_code == 1
    line = _lines(result, "folder")
    assert line.startswith("FAIL")
    assert str(place) in line
    assert "IDENTKNEE_CACHE" in line


def test_an_extra_may_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch, "no-such-package>=2; extra == 'cluster'", "ruff; extra == 'lint'")
    result = run("doctor")
    assert result.exit_code == 0, result.output
    line = _lines(result, "cluster")
    assert re.match(r"ok +cluster: .*no-such-package.*'identknee\[cluster\]'$", line)
    assert "lint" not in result.stdout


def test_wrong_poses_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch)
    monkeypatch.setattr(installation, "SAME_MM_OR_DEG", -1.0)
    result = run("doctor")
    assert result.exit_code == 1
    assert _lines(result, "poses").startswith("FAIL")
    assert _lines(result, "fit").startswith("ok")


def test_a_library_that_breaks_is_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    _installed(monkeypatch)

    fault = "numba needs numpy 2.2\nor less."

    def broken() -> ik.Knee:
        raise ImportError(fault)

    monkeypatch.setattr(installation, "reference_knee", broken)
    result = run("doctor")
    assert result.exit_code == 1
    assert f"ImportError: {' '.join(fault.split())}" in _lines(result, "run")


def test_the_stored_poses_are_the_pinned_ones() -> None:
    pinned = json.loads((ROOT / "tests/pinned/reference_knee.json").read_text(encoding="utf-8"))
    trials = list(pinned["calibration"]["poses"])
    stored = ik.read_laxity(Path(str(files("identknee.verbs").joinpath("self_test.csv"))))
    rows = [trials.index(x) for x in stored.protocol.trials]
    np.testing.assert_array_equal(
        stored.coordinates, np.array(pinned["program"]["coordinates"])[rows]
    )
