"""Whether errors of zero at each flexion angle explain a misfit better than any other cause."""

import numpy as np

from identknee.diagnosis.explanations.refit import FAR_EVIDENCE, Refit, refit
from identknee.diagnosis.score.signature import Signature, project_signature
from identknee.model.effects.remounting import Remounting, remounting

# Score of such errors from which on a fit with them is worth its time: data without a cause have 0
# to 1, those of 0.3 mm and deg of such errors 8 and more.
LEAST_SCORE = 4.0
# Trials of an angle that tell its zero from what their loads do, on average.
LEAST_TRIALS = 5


def remounted(base: Refit, best: Refit) -> Remounting | None:
    """Such errors, where they explain the misfit of `base` far better than `best` does; else None.

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
