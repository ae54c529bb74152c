"""Errors of what is stated, tried as causes by themselves: insertions, and zeros at each angle."""

import numpy as np

from identknee.diagnosis.explanations.fitting import Fitted
from identknee.diagnosis.explanations.refit import FAR_EVIDENCE, Refit, refit
from identknee.diagnosis.score.signature import Signature, project_signature
from identknee.identify.nuisances import IMPROBABLE
from identknee.model.effects.insertion import BONES
from identknee.model.effects.moved_insertion import MovedInsertion, moved_insertion
from identknee.model.effects.remounting import Remounting, remounting
from identknee.runs.declare import declared, entry

# Score of errors of zero from which on a fit with them is worth its time: data without a cause have
# 0 to 1, those of 0.3 mm and deg of such errors 8 and more.
LEAST_SCORE = 4.0
# Trials of an angle that tell its zero from what their loads do, on average.
LEAST_TRIALS = 5


@declared
class BeyondPrior:
    """What of the insertions lies beyond its prior."""

    causes: tuple[MovedInsertion, ...] = entry("The insertions beyond it, each as a cause")
    p_value: float = entry(
        "Probability that the farthest of all nuisances lies so far out by chance; 1 without any"
    )


def insertions_beyond(fitted: Fitted) -> BeyondPrior:
    """The insertions that a fit moves farther than 3 standard deviations of what is stated."""
    knee = fitted.model.knee
    places = {f"insertion.{x.name}_{y}": (x.name, y) for x in knee.ligaments for y in BONES}
    groups = fitted.nuisance_groups
    chance = {x.name: len(groups) * x.p_value for x in groups if x.name in places}
    beyond = {name: p_value for name, p_value in chance.items() if p_value < IMPROBABLE}
    return BeyondPrior(
        causes=tuple(moved_insertion(knee, *places[name]) for name in beyond),
        p_value=min(beyond.values(), default=1.0),
    )


def remounted(base: Refit, best: Refit) -> Remounting | None:
    """Errors of zero at each angle where they explain a misfit far better than `best`; else None.

    Other causes leave much the same in all trials of an angle, so these errors are no candidate
    beside them: they count where their evidence is clearly the highest.

    Parameters
    ----------
    base
        The fit without causes.
    best
        The best explanation by other causes, or `base`.
    """
    protocol, stated = base.fitted.laxity.protocol, base.fitted.model.knee.uncertainty
    angles = np.unique(protocol.flexion_deg)
    if max(stated.zero_mm, stated.zero_deg) > 0.0 or protocol.n < LEAST_TRIALS * len(angles):
        return None
    effect = remounting(angles.tolist())
    if base.fitted.laxity.zero != "absolute" or _score(base, effect) < LEAST_SCORE:
        return None
    start = np.r_[base.fitted.theta, effect.parameters.center]
    explained = refit(base, [effect], [start])
    return effect if explained.log_evidence > best.log_evidence + FAR_EVIDENCE else None


def _score(base: Refit, effect: Remounting) -> float:
    """How strongly the fit speaks for the errors, in units of its own residuals."""
    fitted, p = base.fitted, effect.parameters
    model = fitted.model.with_effects([*fitted.model.effects, effect])
    jacobian = model.predict_once(np.r_[fitted.theta, p.center]).jacobian
    if jacobian is None:  # pragma: no cover - it was asked for
        raise AssertionError
    signature = Signature(
        name=effect.name,
        variant="",
        columns=fitted.columns(jacobian[:, :, -p.n :]),
        prior_sd=p.prior_sd,
        sign=np.zeros(p.n, np.int64),
    )
    projector = fitted.projector
    seen = project_signature(projector, signature)
    left = projector.project(fitted.residual_rows())
    left *= np.sqrt(projector.degrees_of_freedom) / np.linalg.norm(left)
    return float(seen.z_score(seen.gain((left @ seen.projected)[None]))[0])
