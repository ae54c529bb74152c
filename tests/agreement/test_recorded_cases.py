"""Tables on which something once broke, whole."""

import numpy as np
import pytest
from data_files import DATA

from identknee.diagnosis.investigation import investigate
from identknee.diagnosis.verdict import Verdict
from identknee.laxity.table import read_laxity
from identknee.subject.folder import example

# Another generator's data of this knee with its insertions 2 mm wrong; see the page in `data`.
CASE = DATA / "singular_matrix.csv"


def test_the_case_is_a_whole_table() -> None:
    laxity = read_laxity(CASE)
    assert laxity.n == 63
    assert laxity.is_measured.all()
    assert laxity.sd is not None
    np.testing.assert_array_equal(laxity.sd, np.full((63, 5), 0.3))


@pytest.mark.slow
def test_wrong_insertions_are_not_passed_as_adequate() -> None:
    """It once ended in a singular matrix, of trials that a candidate cause had lost."""
    found = investigate(example("lenhart2015_stable"), read_laxity(CASE))
    assert found is not None
    assert found.conclusion.verdict is not Verdict.ADEQUATE
