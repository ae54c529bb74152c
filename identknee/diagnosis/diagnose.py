"""What measured laxity says against a model: the misfit, its cause, the extended model."""

from collections.abc import Sequence
from dataclasses import dataclass

from identknee.diagnosis.advice import Advice, advise
from identknee.diagnosis.attribution import Attribution, attribute
from identknee.diagnosis.base_fit import BaseFit, fit_base, fit_from
from identknee.diagnosis.data_noise import DataNoise
from identknee.diagnosis.goodness import smooth_patterns
from identknee.diagnosis.localisation import Localisation, TrialLayout, localise
from identknee.diagnosis.missing_line import LineFinding, find_line
from identknee.diagnosis.refit import Refit
from identknee.diagnosis.verdict import LEVEL, Conclusion, Verdict, alarm_p_value, conclude
from identknee.laxity.table import COORDINATES, Laxity
from identknee.model.effects.effect import Effect
from identknee.model.effects.library import library
from identknee.runs.arrays import Array
from identknee.subject.knee import Knee

DIRECTIONS = (
    ("internal moment", "external moment"),
    ("varus moment", "valgus moment"),
    ("anterior force", "posterior force"),
    ("distraction", "compression"),
    ("lateral force", "medial force"),
)
# Of the deviance: another minimum of the base model, and not the end of the same one.
LOWER = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Diagnosis:
    """What the data say against the model of a subject.

    Attributes
    ----------
    laxity
        The data.
    noise
        Their errors.
    base
        The fit of the model without causes.
    localisation
        Where its misfit is.
    attribution
        The explanations tried.
    conclusion
        The verdict.
    advice
        Trials to add; None where nothing is to be told apart.
    line
        The line of force that explains most where no known cause does; None elsewhere.
    seed
        Of the distributions under no effect.
    """

    laxity: Laxity
    noise: DataNoise
    base: Refit
    localisation: Localisation
    attribution: Attribution
    conclusion: Conclusion
    advice: Advice | None
    line: LineFinding | None
    seed: int


def diagnose(
    knee: Knee,
    laxity: Laxity,
    *,
    starts: Sequence[Array] = (),
    effects: Sequence[Effect] | None = None,
    seed: int = 0,
) -> Diagnosis | None:
    """What the data say against the model of a knee; None where they cannot be tested.

    Parameters
    ----------
    knee, laxity
        The subject and the data.
    starts
        Ligament parameters at which fits begin besides the subject's own, each shape ``(2m,)``.
    effects
        Candidates; the whole library where None.
    seed
        Of the distributions under no effect.
    """
    if effects is None:
        effects = _not_stored(knee, laxity)
    found = fit_base(knee, laxity, starts=starts, seed=seed)
    if found is None or not found.fitted.evaluation.is_finite:
        return None
    attribution, p_value = _explained(found, effects, seed)
    if (start := lower_start(attribution)) is not None:
        found = fit_base(knee, laxity, starts=[*starts, start], seed=seed) or found
        attribution, p_value = _explained(found, effects, seed)
    base = attribution.base
    conclusion = conclude(attribution, p_value)
    is_open = conclusion.verdict is Verdict.AMBIGUOUS
    is_unknown = conclusion.verdict is Verdict.UNEXPLAINED
    return Diagnosis(
        laxity=laxity,
        noise=found.found,
        base=base,
        localisation=_localisation(base, seed),
        attribution=attribution,
        conclusion=conclusion,
        advice=advise(attribution, laxity, found.found) if is_open else None,
        line=find_line(base, seed=seed) if is_unknown else None,
        seed=seed,
    )


def _explained(found: BaseFit, effects: Sequence[Effect], seed: int) -> tuple[Attribution, float]:
    """The explanation of what a fit leaves, and how probable so clear a misfit is."""
    base = _base_refit(found)
    attribution = attribute(base, effects, seed=seed)
    p_value = alarm_p_value(base, attribution.steps[0].scores.p_value)
    if p_value <= LEVEL and not attribution.steps[0].is_significant:
        attribution = attribute(base, effects, seed=seed, is_forced=True)
    return attribution, p_value


def lower_start(attribution: Attribution) -> Array | None:
    """Ligament parameters from which the base model fits better than it did; None without any.

    A cause that has no size may have led the fit to a better minimum of the base model.
    """
    base, best = attribution.base.fitted, attribution.best.fitted
    if best is base:
        return None
    n_base = attribution.base.n_base
    again = fit_from(base.model, base.laxity, base.noise, [best.theta[:n_base]])
    if again.evaluation.deviance > base.evaluation.deviance - LOWER:
        return None
    return again.theta[: base.model.n_ligament_parameters]


def _not_stored(knee: Knee, laxity: Laxity) -> tuple[Effect, ...]:
    """The library without what the subject has already."""
    whole = library(knee, has_order=laxity.order is not None, has_phase=laxity.phase is not None)
    return tuple(x for x in whole if x.name not in {own.name for own in knee.effects})


def _base_refit(found: BaseFit) -> Refit:
    fitted = found.fitted
    protocol = fitted.laxity.protocol
    patterns = smooth_patterns(protocol.loads, protocol.flexion_deg, fitted.laxity.is_measured)
    return Refit(
        causes=(),
        fitted=fitted,
        smooth=fitted.noise.whiten(patterns),
        noise_degrees=found.found.degrees_of_freedom,
    )


def layout_of(laxity: Laxity) -> TrialLayout:
    """How the trials of the data are told apart."""
    return TrialLayout(
        flexion_deg=laxity.protocol.flexion_deg,
        loads=laxity.protocol.loads,
        directions=DIRECTIONS,
        coordinates=COORDINATES,
        is_measured=laxity.is_measured,
    )


def _localisation(base: Refit, seed: int) -> Localisation:
    fitted = base.fitted
    layout = layout_of(fitted.laxity)
    return localise(fitted.residual_rows(), base.projector, fitted.noise, layout, seed=seed)
