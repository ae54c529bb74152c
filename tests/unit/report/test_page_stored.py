"""Results read back are the results that were stored."""

import json
from dataclasses import replace
from pathlib import Path

from diagnoses import FRAME, diagnosed
from report_folders import diagnosis_folder, profile_folder, straight_profiles

from identknee.diagnosis.explanations.causes import ligament_estimates
from identknee.report.page.results import found_results
from identknee.report.page.stored import (
    stored_estimates,
    stored_localisation,
)
from identknee.runs.plain_records import to_plain
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
    found = diagnosed(FRAME)
    (result,) = found_results(diagnosis_folder(tmp_path))
    stored = stored_localisation(result)
    assert {(x.coordinate, x.flexion_deg, x.direction, x.score) for x in stored.cells} == {
        (x.coordinate, x.flexion_deg, x.direction, x.score) for x in found.localisation.cells
    }
    assert len(stored.region) == len(found.localisation.region)
    assert stored.share == found.localisation.share
    made = ligament_estimates(found.base)
    for owner, own in stored_estimates(result, "before").items():
        for name, estimate in own.items():
            expected = made[owner][name]
            assert (estimate.value, estimate.unit) == (expected.value, expected.unit)
            assert estimate.ci95 == tuple(expected.ci95)
