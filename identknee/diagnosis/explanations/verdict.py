"""What a diagnosis concludes: one of five verdicts, with its reasons."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from identknee.diagnosis.explanations.attribution import Attribution
from identknee.diagnosis.explanations.refit import Refit
from identknee.diagnosis.score.misfit import log_weighted_tail
from identknee.model.effects.facts import cause_label
from identknee.model.effects.placed import Structure
from identknee.runs.declare import declared, entry

LEVEL = 0.05
# A model whose misfit is less probable is not the explanation, or not all of it.
FITS, HARDLY_FITS = 0.01, 0.001
# Insertions less probable than this may be those of another structure.
FAR_OFF = 0.1
# Share of the prior variance of a shift: data that take off less know nothing of it.
LEAST_MOVED = 1e-6
# Multiples of a stated noise up to which it is asked how much noise would explain a misfit.
MULTIPLES = (1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
# A verdict that holds for only some of these multiples of a stated noise is none.
NOISE_FACTORS = (0.75, 1.33)
HANGS_ON_NOISE = (
    "The verdict depends on the noise, which the data state but do not show: with 0.75 or 1.33 "
    "times that noise it would be different. Measure longer load curves or replicates."
)


SEVERAL = "The model gets something wrong, and more than one known cause fits."
UNTESTED = "The model gets something wrong that no known cause explains that could be tested."


class Verdict(StrEnum):
    """The five ways in which a diagnosis ends."""

    ADEQUATE = "ADEQUATE"
    NAMED = "NAMED"
    AMBIGUOUS = "AMBIGUOUS"
    UNEXPLAINED = "UNEXPLAINED"
    NOT_TESTABLE = "NOT_TESTABLE"

    @property
    def sentence(self) -> str:
        """What it means."""
        return _SENTENCES[self]


_SENTENCES = {
    Verdict.ADEQUATE: "The data show nothing that the model gets wrong.",
    Verdict.NAMED: "The data show what the model gets wrong, and only one known cause fits.",
    Verdict.AMBIGUOUS: "The model gets something wrong, and the data leave its cause open.",
    Verdict.UNEXPLAINED: "The model gets something wrong that no known cause explains.",
    Verdict.NOT_TESTABLE: "The data cannot say whether the model gets anything wrong.",
}


@declared
class Conclusion:
    """A verdict and what it stands on."""

    verdict: Verdict = entry("One of five")
    sentence: str = entry("What it means here")
    p_value: float = entry(
        "Probability of a misfit as clear as this one of the base model, under noise alone"
    )
    best: Refit = entry("The model with the causes found; the base model where none was")
    group: tuple[str, ...] = entry(
        "Names of all causes that would explain the data, the best first; empty without any"
    )
    reasons: tuple[str, ...] = entry("Sentences for the user")


def conclude(attribution: Attribution, p_value: float) -> Conclusion:
    """The verdict on an attribution whose base model's misfit has this probability."""
    best, base = attribution.best, attribution.base
    if _hangs_on_noise(attribution, p_value):
        return _conclusion(Verdict.NOT_TESTABLE, p_value, base, (), [HANGS_ON_NOISE])
    if p_value > LEVEL:
        reasons = [f"Noise alone explains the misfit ({_p_words(p_value)})."]
        return _conclusion(Verdict.ADEQUATE, p_value, base, (), reasons)
    reasons = [f"Noise alone does not explain the misfit ({_p_words(p_value)})."]
    untested = [x.reason for x in attribution.untested_rivals]
    fits = best.misfit_p_value
    faults = ["No effect of the library fits better than the model without it."]
    if best.causes:
        faults = _faults(best, fits)
    if faults:
        reasons = [f"{reasons[0]}{_noise_that_would(attribution)}", *faults, *untested]
        sentence = UNTESTED if untested else Verdict.UNEXPLAINED.sentence
        return _conclusion(Verdict.UNEXPLAINED, p_value, best, (), reasons, sentence)
    doubts = _doubts(attribution, fits)
    group = _group(attribution)
    is_alone = len(group) == len(best.causes)
    if is_alone and not doubts and not untested:
        return _conclusion(Verdict.NAMED, p_value, best, group, reasons)
    reasons += [*(x.reason for x in doubts), *untested]
    short = [x.short for x in doubts] + ["another cause could not be tested"] * bool(untested)
    sentence = _ambiguous(len(best.causes), short) if is_alone else SEVERAL
    return _conclusion(Verdict.AMBIGUOUS, p_value, best, group, reasons, sentence)


def _p_words(p_value: float) -> str:
    """A probability as papers print it."""
    return "p < 0.001" if p_value < 0.001 else f"p = {p_value:.2g}"


def _ambiguous(n_causes: int, doubts: Sequence[str]) -> str:
    """What AMBIGUOUS means where one explanation alone fits."""
    fits = "one known cause fits" if n_causes == 1 else f"{n_causes} known causes together fit"
    return f"The model gets something wrong, and {fits}, with a doubt: {'; '.join(doubts)}."


def _hangs_on_noise(attribution: Attribution, p_value: float) -> bool:
    """Whether noise that is only stated, if wrong by a quarter or a third, turns the verdict."""
    base = attribution.base
    if np.isfinite(base.noise_degrees):
        return False
    score = attribution.steps[0].scores.p_value
    others = [base.alarm_p_value(score, factor) <= LEVEL for factor in NOISE_FACTORS]
    return any(x != (p_value <= LEVEL) for x in others)


def _noise_that_would(attribution: Attribution) -> str:
    """About how much larger than stated the noise would have to be, as one more sentence."""
    base, score = attribution.base, attribution.steps[0].scores.p_value
    if np.isfinite(base.noise_degrees):
        return ""
    enough = (x for x in MULTIPLES if base.alarm_p_value(score, x) > LEVEL)
    factor = next(enough, None)
    if factor is None:
        return f" Nor would {MULTIPLES[-1]:g} times the noise stated: the misfit has a pattern."
    return f" About {factor:g} times the noise stated would."


def _conclusion(
    verdict: Verdict,
    p_value: float,
    best: Refit,
    group: Sequence[str],
    reasons: Sequence[str],
    sentence: str = "",
) -> Conclusion:
    return Conclusion(
        verdict=verdict,
        sentence=sentence or verdict.sentence,
        p_value=p_value,
        best=best,
        group=tuple(group),
        reasons=tuple(reasons),
    )


def _faults(best: Refit, fits: float) -> list[str]:
    """Why the best explanation is none."""
    names = " and ".join(map(cause_label, best.names))
    faults = []
    if fits <= HARDLY_FITS:
        faults.append(f"With {names} the misfit is still improbable ({_p_words(fits)}).")
    faults += [
        f"The {cause_label(name)} would need an amplitude at the end of its plausible range."
        for name in best.names
        if best.is_at_end(name)
    ]
    return faults


@dataclass(frozen=True, slots=True, kw_only=True)
class _Doubt:
    """Why the best explanation may not be the right one or not all: in a few words, and whole."""

    short: str
    reason: str


def _doubts(attribution: Attribution, fits: float) -> list[_Doubt]:
    """What speaks against the best explanation, none of it enough to refuse it."""
    best = attribution.best
    doubts = [
        _Doubt(
            short=f"the {cause_label(x.name)} would lie far from where anatomy has it",
            reason=f"The insertions of the {cause_label(x.name)} would lie "
            f"{shift_mm(best, x):.0f} mm from where anatomy has them, which is rare "
            f"({_p_words(p_value)}): a structure that no library lists may lie there.",
        )
        for x in best.causes
        if isinstance(x, Structure) and (p_value := site_p_value(best, x)) <= FAR_OFF
    ]
    if fits <= FITS:
        reason = f"The misfit that is left is rather improbable ({_p_words(fits)})."
        doubts.append(_Doubt(short="it leaves more than noise would", reason=reason))
    if attribution.is_left_unexplained:
        further = cause_label(attribution.steps[-1].scores.candidates[0].name)
        reason = f"Something else is left: the {further} scores high but does not fit."
        doubts.append(_Doubt(short="something else is left", reason=reason))
    return doubts


def _group(attribution: Attribution) -> tuple[str, ...]:
    """All causes of the best explanation and of the rivals still open."""
    names = list(attribution.best.names)
    for rival in attribution.open_rivals:
        names += [x for x in rival.refit.names if x not in names]
    return tuple(names)


def site_p_value(refit: Refit, structure: Structure) -> float:
    """Probability that the insertions of a structure are found so far from where anatomy has them.

    The shifts found are compared with what their prior, and how much of it the data can move, lead
    one to expect: of a shift with prior variance 1 and posterior variance c, the value found has
    the variance 1 - c. 1 for a structure whose insertions are fixed or that pulls at nothing.

    Parameters
    ----------
    refit
        The fit with the structure.
    structure
        One of its causes.
    """
    p = structure.parameters
    if not structure.sites_vary:
        return 1.0
    shifts = slice(structure.first_shift, None)
    places = refit.places(structure.name)[shifts]
    prior_sd = p.prior_sd[shifts]
    shift = (refit.fitted.theta[places] - p.center[shifts]) / prior_sd
    left = refit.covariance()[np.ix_(places, places)] / np.outer(prior_sd, prior_sd)
    weights = np.clip(np.linalg.eigvalsh(np.eye(len(places)) - left), 0.0, 1.0)
    # Without stiffness the data move no insertion.
    if weights.max() < LEAST_MOVED:
        return 1.0
    return float(np.exp(log_weighted_tail(np.array([shift @ shift]), weights)[0]))


def shift_mm(refit: Refit, structure: Structure) -> float:
    """How far the farther insertion is found from where anatomy has it [mm]."""
    shifts = refit.amplitudes(structure.name)[structure.first_shift :].reshape(-1, 3)
    return float(np.linalg.norm(shifts, axis=1).max(initial=0.0))
