"""Results read back are the results that were stored."""

import json
from dataclasses import replace
from pathlib import Path

from diagnoses import FRAME, answered
from report_folders import diagnosis_folder, profile_folder, straight_profiles

from identknee.runs.files import plain
from identknee.runs.schema import to_plain
from identknee.verbs.diagnosis import Diagnosis
from identknee.verbs.files import load
from identknee.verbs.profile import Profiles


def test_profiles_come_back(tmp_path: Path) -> None:
    stored = load(profile_folder(tmp_path))
    assert isinstance(stored, Profiles)
    # As text, because NaN differs from itself.
    again, made = (
        json.dumps(to_plain(replace(x, record=None))) for x in (stored, straight_profiles())
    )
    assert again == made


def test_a_diagnosis_comes_back(tmp_path: Path) -> None:
    stored = load(diagnosis_folder(tmp_path))
    assert isinstance(stored, Diagnosis)
    again, made = (
        json.dumps(plain(to_plain(replace(x, record=None)))) for x in (stored, answered(FRAME))
    )
    assert again == made
