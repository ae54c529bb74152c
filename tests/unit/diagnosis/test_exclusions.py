"""What a diagnosis says of every effect."""

import numpy as np
from diagnoses import FRAME, diagnosed

from identknee.diagnosis.score import HIGH_POWER, Cell
from identknee.model.effects.library import library
from identknee.subject.knee import Knee


def test_every_effect_is_judged_by_score_and_power(reference: Knee) -> None:
    found = diagnosed(None).exclusions
    assert [x.name for x in found] == [x.name for x in library(reference)]
    for x in found:
        assert x.cell in (Cell.EXCLUDED, Cell.INCONCLUSIVE)
        assert (x.cell is Cell.EXCLUDED) == (x.power >= HIGH_POWER)
        # Not a number where no plausible size would be seen.
        assert not x.detectable <= 0.0
    assert {x.cell for x in found} == {Cell.EXCLUDED, Cell.INCONCLUSIVE}


def test_what_is_found_in_nine_of_ten_is_what_has_that_power() -> None:
    """The smallest size worth knowing is found as often as its place beside the other says."""
    for x in diagnosed(None).exclusions:
        if np.isfinite(x.detectable):
            assert (x.power >= 0.9) == (x.relevant >= x.detectable)


def test_the_cause_is_judged_as_it_was_before_it_was_known() -> None:
    found = {x.name: x for x in diagnosed(FRAME).exclusions}
    assert found[FRAME].cell in (Cell.MISSPECIFIED, Cell.INSPECT)
    others = [x for name, x in found.items() if name != FRAME]
    assert not any(x.cell in (Cell.MISSPECIFIED, Cell.INSPECT) for x in others)
