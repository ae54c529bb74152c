"""Tables that are wrong as a whole end in a sentence, never in a silent answer."""

from dataclasses import replace

import numpy as np
import pytest
from small_knee import as_read, small_knee

import identknee as ik
from identknee.checks.table_checks import frame_findings, load_findings
from identknee.laxity.table import Laxity, example_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.runs.findings import Severity
from identknee.runs.record import Outcome
from identknee.subject.folder import read_subject

pytestmark = pytest.mark.usefixtures("few_starts")


def begun(subject: str, laxity: Laxity) -> LaxityModel:
    return LaxityModel(knee=read_subject(subject), protocol=laxity.protocol).with_tests(laxity)


@pytest.mark.slow
def test_changes_from_a_pose_are_not_taken_for_coordinates() -> None:
    laxity = example_laxity("s192803")
    zeroed = replace(laxity, coordinates=laxity.coordinates - laxity.coordinates[-1])
    for subject in ("s192803", "s192803_bundles"):
        assert frame_findings(begun(subject, laxity)) == ()
        (finding,) = frame_findings(begun(subject, zeroed))
        assert (finding.code, finding.severity) == ("coordinates-of-other-frames", Severity.ERROR)


def test_a_table_of_deep_flexion_alone_is_one_of_this_knee() -> None:
    laxity = example_laxity("s192803")
    deep = laxity.select(np.flatnonzero(laxity.protocol.flexion_deg > 80.0))
    assert frame_findings(begun("s192803_bundles", deep)) == ()


@pytest.mark.usefixtures("no_conventions")
def test_a_table_without_loads_is_said_to_have_none() -> None:
    laxity = as_read()
    assert load_findings(laxity) == ()
    unloaded = replace(laxity.protocol, loads=np.zeros_like(laxity.protocol.loads))
    found = ik.fit(small_knee(), replace(laxity, protocol=unloaded), budget=3)
    assert "no-loads" in {x.code for x in found.findings}


def test_what_was_not_measured_is_said_by_a_fit() -> None:
    laxity = as_read()
    coordinates = np.array(laxity.coordinates)
    coordinates[3], coordinates[:, 2] = np.nan, np.nan
    sd = np.full(coordinates.shape, np.nan)
    sd[:, 3] = 1.0
    found = ik.fit(small_knee(), replace(laxity, coordinates=coordinates, sd=sd), budget=3)
    said = " ".join(found.assumptions)
    for part in ("distraction_mm was not", "trial 3", "of varus_deg only"):
        assert part in said


def test_a_start_outside_the_bounds_is_said_to_be_the_reason() -> None:
    knee, laxity = small_knee(), as_read()
    names = LaxityModel(knee=knee, protocol=laxity.protocol).parameters.names
    narrow = {name: (-60.0, -59.0) for name in names if name.endswith("_pct")}
    found = ik.fit(knee, laxity, bounds=narrow)
    assert found.outcome is Outcome.START_FAILED
    assert found.trials_used == ()
    (nothing,) = [x for x in found.findings if x.code == "nothing-fitted"]
    # No trial is to blame.
    assert not nothing.values
    assert found.failure == nothing.sentence
