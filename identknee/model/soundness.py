"""Checks of the model behind a result: stability, and contact near rims."""

from collections.abc import Sequence

import numpy as np

from identknee.model.insertion_moves import ENOUGH_MARGIN
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction
from identknee.model.stability import counted_outcomes
from identknee.runs.findings import Finding, Severity


def stability_findings(model: LaxityModel) -> tuple[Finding, ...]:
    """Whether the subject is stable at its own parameters under the trials of its data.

    What `identknee subject check` finds there goes with every result, because results of a knee
    that folds hang on where it folds.
    """
    found = model.predict(model.parameters.start, derivatives=False)
    n = model.protocol.n
    if not found.all_converged:
        lost = np.flatnonzero(~found.is_converged)
        first = model.protocol.trials[int(lost[0])]
        sentence = (
            f"The subject fails its stability check: at its own parameters {lost.size} of {n} "
            f"trials have no equilibrium ({counted_outcomes(found.outcomes)}; the first is "
            f"{first}). See: identknee subject check SUBJECT --protocol DATA.csv"
        )
        return (Finding(severity=Severity.WARNING, sentence=sentence, where="subject"),)
    lowest = float(np.nanmin(found.margins, initial=np.inf))
    if lowest < ENOUGH_MARGIN:
        weakest = model.protocol.trials[int(np.nanargmin(found.margins))]
        sentence = (
            f"At its own parameters the subject is hardly stable: {lowest:.2g} N/mm in {weakest}, "
            f"less than {ENOUGH_MARGIN:g}. See: identknee subject check"
        )
        return (Finding(severity=Severity.WARNING, sentence=sentence, where="subject"),)
    return ()


def rim_findings(trials: Sequence[str], found: Prediction) -> tuple[Finding, ...]:
    """Trials with contact near a rim, where the cartilage surface ends."""
    near = np.flatnonzero(found.is_near_rim)
    if not near.size:
        return ()
    worst = near[int(np.argmax(found.rim_share[near]))]
    many = "1 trial" if near.size == 1 else f"{near.size} trials"
    sentence = (
        f"In {many} contact acts within 3 mm of a rim, where the surface ends (most in "
        f"{trials[worst]}, {found.rim_share[worst]:.0%} of the force): cartilage beyond the rim is "
        "missing from the model."
    )
    return (Finding(severity=Severity.INFO, sentence=sentence, where="subject"),)
