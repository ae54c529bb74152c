"""The study of wrong geometries: its errors, its counting, and that it resumes."""

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from study_modules import STUDIES, study_module

from identknee.laxity.protocol import load_protocol
from identknee.subject.knee import Knee

FOLDER = STUDIES / "12_geometry_uncertainty"


def load(name: str) -> ModuleType:
    return study_module(FOLDER / f"{name}.py")


def test_errors_have_the_size_they_say(reference: Knee) -> None:
    with_error = load("compute").with_error
    protocol = load_protocol("seed63")
    generator = np.random.default_rng(0)
    task = {"kind": "insertions", "size": 2.0}
    moves = []
    for _ in range(50):
        knee, loads = with_error(reference, protocol, task, generator)
        assert loads is protocol
        for one, other in zip(knee.ligaments, reference.ligaments, strict=True):
            moves += [*(one.femur - other.femur), *(one.tibia - other.tibia)]
    # 1,200 draws: five standard errors of their spread.
    assert np.std(moves) == pytest.approx(2.0, abs=5 * 2.0 / np.sqrt(2 * len(moves)))
    knee, _ = with_error(reference, protocol, {"kind": "tibial frame", "size": 3.0}, generator)
    turn = knee.tibia_frame.axes @ reference.tibia_frame.axes.T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(3.0)
    assert knee.ligaments is reference.ligaments
    knee, loads = with_error(reference, protocol, {"kind": "load axes", "size": 5.0}, generator)
    assert knee is reference
    size = np.hypot(protocol.loads[:, 0], protocol.loads[:, 1])
    off = np.hypot(*(loads.loads - protocol.loads)[:, :2].T)
    assert np.all(off <= size * 2 * np.sin(np.radians(2.5)) + 1e-12)
    assert off.max() > 0.0
    for kind in ("insertions", "load axes", "tibial frame"):
        knee, loads = with_error(reference, protocol, {"kind": kind, "size": 0.0}, generator)
        assert np.array_equal(loads.loads, protocol.loads)
        assert np.allclose(knee.tibia_frame.axes, reference.tibia_frame.axes)
        assert np.array_equal(knee.ligaments[0].femur, reference.ligaments[0].femur)


def fit_row(ratio: float | None, deviance: float) -> dict[str, Any]:
    return {
        "kind": "insertions",
        "size": 1.0,
        "theta": [1.0, 2.0],
        "forces": [5.0],
        "force_rms_N": [1.0],
        "deviance": deviance,
        "ratios": [ratio, 0.0, 0.0],
        "outcome": "minimum",
        "at_bound": [False, False],
    }


def test_coverage_counts_what_cannot_be_fitted_as_not_covered() -> None:
    rows = [
        fit_row(3.0, 100.0),
        fit_row(30.0, 1000.0),
        fit_row(None, 100.0),
        {"kind": "insertions", "size": 1.0, "theta": None},
        {"kind": "none", "size": 0.0, "theta": None},
    ]
    part = {"fits": rows, "parameters": ["a", "b"], "forces": ["x"], "n_residuals": 102}
    level = load("figures").Level(part, "insertions", 1.0)
    assert level.n == 4
    assert level.is_covered[:, 0].tolist() == [True, False, False, False]
    assert level.is_covered_scaled[:, 0].tolist() == [True, True, False, False]
    assert level.is_covered[:, 1].tolist() == [True, True, True, False]
    assert chi2.ppf(0.95, level.degrees) > 100.0
    assert level.misfit_share == 0.5


def test_fits_are_kept_and_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = load("compute")
    monkeypatch.setattr(module, "LEVELS", (("none", 0.0),))
    monkeypatch.setattr(module, "FITS", 1)
    record, store = tmp_path / "record.json", tmp_path / "store.sqlite"
    words = ["--store", str(store), "--record", str(record), "--workers", "1", "--replicates", "1"]
    monkeypatch.setattr(sys, "argv", ["compute.py", *words])
    module.main()
    first = json.loads(record.read_text(encoding="utf-8"))
    (row,) = first["knees"]["reference"]["fits"]
    assert row["outcome"] == "minimum"
    assert len(row["ratios"]) == 8 + 4
    assert min(row["ratios"]) >= 0.0
    # Chi-squared with one degree of freedom exceeds 20 once in 130,000.
    assert max(row["ratios"]) < 20.0
    assert np.abs(np.array(row["theta"]) / first["knees"]["reference"]["truth"] - 1).max() < 0.5

    def made_again(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(module, "replicate_row", made_again)
    module.main()
    assert json.loads(record.read_text(encoding="utf-8"))["knees"] == first["knees"]
