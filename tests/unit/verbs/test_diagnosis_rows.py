"""What a diagnosis says that comes neither from its causes nor from its misfit."""

from dataclasses import replace

import numpy as np
from diagnoses import FRAME, diagnosed

from identknee.diagnosis.verdict import Verdict
from identknee.verbs.diagnosis_rows import advice_findings


def test_where_nothing_explains_the_misfit_repeats_are_asked_for() -> None:
    found = diagnosed(FRAME)
    conclusion = replace(found.conclusion, verdict=Verdict.UNEXPLAINED)
    unexplained = replace(found, conclusion=conclusion, advice=None)
    (finding,) = advice_findings(unexplained)
    assert "nothing explains the misfit" in finding.sentence
    left = np.nansum((found.base.fitted.differences / found.noise.sd) ** 2, axis=1)
    worst = found.laxity.protocol.trials[int(np.argmax(left))]
    assert f"left in {worst}, " in finding.sentence
    # Nothing is stated to be uncertain there.
    assert "stated as uncertain" not in finding.sentence
    assert advice_findings(replace(found, advice=None)) == ()
