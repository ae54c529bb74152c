"""Which trials of a table are asked about."""

from dataclasses import replace

import numpy as np
import pytest
from planted_conventions import clean_table

import identknee as ik
from identknee.checks.left_out_trials import trials_asked
from identknee.checks.table_checks import suspicious_end_points
from identknee.laxity.table import Laxity

OFF = "Valgus_60"


@pytest.fixture(scope="module")
def table() -> Laxity:
    """The measured knee, one of whose trials the table contradicts."""
    return ik.example_laxity("s192803")


def test_what_the_table_contradicts_is_left_out_unless_kept(table: Laxity) -> None:
    found = trials_asked(table)
    assert found.contradicted == (OFF,)
    assert [(x.code, x.where) for x in found.findings] == [("trial-against-course", OFF)]
    assert found.findings[0].values["is_left_out"] is True
    row = table.protocol.trials.index(OFF)
    others = np.arange(table.n) != row
    assert np.isnan(found.laxity.coordinates[row]).all()
    np.testing.assert_array_equal(found.laxity.coordinates[others], table.coordinates[others])
    np.testing.assert_array_equal(found.with_contradicted.coordinates, table.coordinates)
    kept = trials_asked(table, keep=["Valgus*"])
    assert kept.laxity is table
    assert kept.findings == ()


def test_trials_named_are_left_out(table: Laxity) -> None:
    found = trials_asked(table, leave_out=["Anterior_*"])
    gone = [x for x in table.protocol.trials if x.startswith("Anterior_")]
    assert set(found.by_name) == set(gone)
    rows = np.isin(table.protocol.trials, gone)
    assert np.isnan(found.laxity.coordinates[rows]).all()
    codes = {x.where: x.code for x in found.findings}
    assert {codes[x] for x in gone} == {"trial-left-out"}
    assert np.isnan(found.with_contradicted.coordinates[rows]).all()


def test_a_clean_table_keeps_all(table: Laxity) -> None:
    clean = clean_table("reference", 7)[1]
    assert suspicious_end_points(clean) == []
    assert trials_asked(clean).laxity is clean


def test_names_that_no_trial_has_or_that_contradict_are_refused(table: Laxity) -> None:
    with pytest.raises(ValueError, match=r"--keep Valgus_61.*Valgus_60"):
        trials_asked(table, keep=["Valgus_61"])
    with pytest.raises(ValueError, match=r"Valgus_60 .*--keep .*--leave-out"):
        trials_asked(table, keep=["Valgus_60"], leave_out=["Valgus_60"])
    with pytest.raises(ValueError, match="leaves no"):
        trials_asked(replace(table), leave_out=["*"])
