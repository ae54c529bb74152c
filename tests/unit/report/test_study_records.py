import json
from pathlib import Path

import numpy as np
import pytest
from common.records import (
    begun,
    commit,
    knee_digest,
    parsed_options,
    rounded,
    study_knee,
    working,
    write_record,
)

from identknee.runs.errors import InputError

STUDIES = Path(__file__).parents[3] / "studies"


def test_knees_of_studies_are_the_named_subjects_and_the_bundles_of_one() -> None:
    assert study_knee("lenhart2015_stable").name == "lenhart2015_stable"
    assert len(study_knee("lenhart2015_bundles").ligaments) == 55
    with pytest.raises(ValueError, match="subject 'lenhart'"):
        study_knee("lenhart")


def test_the_digest_of_a_knee_changes_with_a_ligament() -> None:
    knee = study_knee("reference")
    other = knee.with_ligaments(knee.ligaments[::-1])
    again = study_knee("reference")
    assert knee_digest(knee) == knee_digest(again)
    assert knee_digest(knee) != knee_digest(other)


def test_rounding_keeps_significant_digits() -> None:
    assert rounded({"a": [1.23456789, np.float64(2e-9)], "b": 12345678, "c": None}, 3) == {
        "a": [1.23, 2e-9],
        "b": 12345678,
        "c": None,
    }


def test_head_says_how_to_do_it_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["compute.py", "--seeds", "2"])
    options = parsed_options(str(STUDIES / "01_model_evaluation" / "compute.py"), seeds=1)
    record = begun(options, ["reference"], ramps=[1.0])
    head = record["head"]
    assert head["command"] == "python studies/01_model_evaluation/compute.py --seeds 2"
    assert head["commit"] == commit()
    assert head["settings"] == {"workers": 2, "seeds": 2, "ramps": [1.0]}
    assert head["inputs"] == {"reference": knee_digest(study_knee("reference"))}
    assert set(head) > {"date", "machine", "versions"}
    assert head["machine"]["cores"] >= 1
    assert record["knees"] == {}


def double(x: int) -> int:
    return 2 * x


def test_what_was_done_is_kept_and_not_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["compute.py", "--store", str(tmp_path / "work")])
    options = parsed_options(str(STUDIES / "01_model_evaluation" / "compute.py"))
    for work in (double, None):
        with working(options, seed=1) as kept:
            assert kept(work, [1, 2], "numbers") == [2, 4]  # type: ignore[arg-type]
    with pytest.raises(InputError), working(options, seed=2) as kept:
        kept(double, [1, 2], "numbers")


def test_a_record_reads_back_equal_with_a_line_for_each_row(tmp_path: Path) -> None:
    record = {"rows": [{"x": 1.5, "y": [1, 2]}, {"x": None, "y": []}], "n": 2, "deep": {"a": [1]}}
    path = write_record(tmp_path / "records" / "r.json", record)
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == record
    assert ' {"x": 1.5, "y": [1, 2]},' in text.splitlines()[2]


def test_what_is_not_finite_becomes_null(tmp_path: Path) -> None:
    path = write_record(tmp_path / "r.json", {"x": np.array([np.nan, 1.0])})
    assert json.loads(path.read_text(encoding="utf-8")) == {"x": [None, 1.0]}


def test_unwritable_folder_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(ValueError, match=r"file: a file"):
        write_record(tmp_path / "file" / "r.json", {})
