"""What a diagnosis says that comes neither from its causes nor from its misfit."""

from dataclasses import replace

import numpy as np
from diagnoses import FRAME, diagnosed

from identknee.diagnosis.verdict import Verdict
from identknee.verbs.diagnosis import advice_findings


def test_where_nothing_explains_the_misfit_repeats_are_asked_for() -> None:
    found = diagnosed(FRAME)
    conclusion = replace(found.conclusion, verdict=Verdict.UNEXPLAINED)
    unexplained = replace(found, conclusion=conclusion, advice=None)
    (finding,) = advice_findings(unexplained)
    assert finding.code == "no-trial-advised"
    left = np.nansum((found.base.fitted.differences / found.noise.sd) ** 2, axis=1)
    worst = found.laxity.protocol.trials[int(np.argmax(left))]
    assert finding.values["trials"][0] == worst
    # Nothing is stated to be uncertain there.
    assert "nuisances" not in finding.values
    assert advice_findings(replace(found, advice=None)) == ()
