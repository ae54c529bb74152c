"""The verdict of a diagnosis, with its reasons."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import reduce

import numpy as np
from scipy.special import ndtri

from identknee.diagnosis.attribution import Attribution
from identknee.diagnosis.misfit import log_weighted_tail
from identknee.diagnosis.missing_line import LineEnds
from identknee.diagnosis.refit import Refit
from identknee.identify.laplace import Interval, Laplace, laplace
from identknee.model.effects.effect import PLAIN, unit_of
from identknee.model.effects.facts import FACTS, cause_label
from identknee.model.effects.insertion import direction_words
from identknee.model.effects.structures import MissingStructure, Structure
from identknee.runs.declare import declared, derived, entry

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
NOISE_DEPENDENT = (
    "The verdict depends on the stated noise, which the data do not confirm: with 0.75 or 1.33 "
    "times that noise it would be different. Measure longer load curves or replicates."
)


SEVERAL = "A misfit is detected, and more than one known cause fits."
UNTESTED = "A misfit is detected that no testable known cause explains."


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
    Verdict.ADEQUATE: "No misfit of the model is detected.",
    Verdict.NAMED: "A misfit is detected, and only one known cause fits.",
    Verdict.AMBIGUOUS: "A misfit is detected, but the data do not determine its cause.",
    Verdict.UNEXPLAINED: "A misfit is detected that no known cause explains.",
    Verdict.NOT_TESTABLE: "The data cannot decide whether the model misfits.",
}


@declared
class Conclusion:
    """A verdict and its basis."""

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
    if _depends_on_noise(attribution, p_value):
        return _conclusion(Verdict.NOT_TESTABLE, p_value, base, (), [NOISE_DEPENDENT])
    if p_value > LEVEL:
        reasons = [f"Noise alone explains the misfit ({_p_words(p_value)})."]
        return _conclusion(Verdict.ADEQUATE, p_value, base, (), reasons)
    reasons = [f"Noise alone does not explain the misfit ({_p_words(p_value)})."]
    untested = [x.reason for x in attribution.untested_rivals]
    fits = best.misfit_p_value
    faults = ["No effect of the library fits better than the model without it."]
    if best.causes:
        faults = _rejection_reasons(best, fits)
    if faults:
        reasons = [f"{reasons[0]}{_noise_explaining_misfit(attribution)}", *faults, *untested]
        sentence = UNTESTED if untested else Verdict.UNEXPLAINED.sentence
        return _conclusion(Verdict.UNEXPLAINED, p_value, best, (), reasons, sentence)
    doubts = _reservations(attribution, fits)
    group = _group(attribution)
    is_alone = len(group) == len(best.causes)
    if is_alone and not doubts and not untested:
        return _conclusion(Verdict.NAMED, p_value, best, group, reasons)
    reasons += [*(x.reason for x in doubts), *untested]
    short = [x.short for x in doubts] + ["another cause could not be tested"] * bool(untested)
    n = len(best.causes)
    fits_words = "one known cause fits" if n == 1 else f"{n} known causes together fit"
    alone = f"The model gets something wrong, and {fits_words}, with a doubt: {'; '.join(short)}."
    sentence = alone if is_alone else SEVERAL
    return _conclusion(Verdict.AMBIGUOUS, p_value, best, group, reasons, sentence)


def _p_words(p_value: float) -> str:
    """A probability as papers print it."""
    return "p < 0.001" if p_value < 0.001 else f"p = {p_value:.2g}"


def _depends_on_noise(attribution: Attribution, p_value: float) -> bool:
    """Whether noise that is only stated, if wrong by a quarter or a third, turns the verdict."""
    base = attribution.base
    if np.isfinite(base.noise_degrees):
        return False
    score = attribution.steps[0].scores.p_value
    others = [base.alarm_p_value(score, factor) <= LEVEL for factor in NOISE_FACTORS]
    return any(x != (p_value <= LEVEL) for x in others)


def _noise_explaining_misfit(attribution: Attribution) -> str:
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


def _rejection_reasons(best: Refit, fits: float) -> list[str]:
    """Reasons to reject the best explanation."""
    names = " and ".join(map(cause_label, best.names))
    faults = []
    if fits <= HARDLY_FITS:
        faults.append(f"With {names} the misfit is still improbable ({_p_words(fits)}).")
    faults += [
        f"The {cause_label(name)} would need an amplitude at the limit of its plausible range."
        for name in best.names
        if best.is_at_range_end(name)
    ]
    return faults


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reservation:
    """Why the best explanation may not be the right one or not all: in a few words, and whole."""

    short: str
    reason: str


def _reservations(attribution: Attribution, fits: float) -> list[_Reservation]:
    """Reservations about the best explanation, none of them sufficient to reject it."""
    best = attribution.best
    doubts = [
        _Reservation(
            short=f"the {cause_label(x.name)} would lie far from its anatomical site",
            reason=f"The insertions of the {cause_label(x.name)} would lie "
            f"{shift_mm(best, x):.0f} mm from their anatomical sites, which is rare "
            f"({_p_words(p_value)}): a structure that no library lists may lie there.",
        )
        for x in best.causes
        if isinstance(x, Structure) and (p_value := site_p_value(best, x)) <= FAR_OFF
    ]
    if fits <= FITS:
        reason = f"The remaining misfit is rather improbable ({_p_words(fits)})."
        doubts.append(_Reservation(short="its residuals exceed the noise", reason=reason))
    if attribution.has_remaining_misfit:
        further = cause_label(attribution.steps[-1].scores.candidates[0].name)
        reason = f"Significant misfit remains: the {further} scores high but does not fit."
        doubts.append(_Reservation(short="significant misfit remains", reason=reason))
    return doubts


def _group(attribution: Attribution) -> tuple[str, ...]:
    """All causes of the best explanation and of the rivals still open."""
    names = list(attribution.best.names)
    for rival in attribution.open_rivals:
        names += [x for x in rival.refit.names if x not in names]
    return tuple(names)


def site_p_value(refit: Refit, structure: Structure) -> float:
    """Probability that the insertions of a structure are found so far from their anatomical sites.

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


TWO_SIDED = float(ndtri(0.975))
TOTAL = "total"


@declared
class Estimate:
    """A number found by a fit."""

    name: str = entry(
        "Name of the parameter, without its owner; total for the length of a vector of several"
    )
    value: float = entry("Its value", unit="as the field unit says")
    unit: str = entry("Its unit; 1 for a plain number")
    ci95: Interval = entry(
        "95 % interval; null where the data give no limit: at a bound, or where the fit that it "
        "is the interval of was stopped",
        unit="as the field unit says",
    )


OF_THE_CALLER = "The library does not know it: it was given by the caller."
OF_AMPLITUDE = "unit of the amplitude"


@declared
class Cause:
    """A cause with its amplitudes."""

    name: str = entry("Name of the cause in the library")
    amplitude: float = entry("The one number that says how large it is", unit=OF_AMPLITUDE)
    unit: str = entry("Unit of the amplitude")
    ci95: Interval = entry(
        "95 % interval; an end at a bound, or of a fit that was stopped, is open and null",
        unit=OF_AMPLITUDE,
    )
    parameter: str = entry("What the amplitude is called")
    parameters: Mapping[str, Estimate] = entry("Every amplitude by its name")
    line: LineEnds | None = entry("Its line of action", only="a structure of one line")

    @property
    @derived("What the cause is, as a sentence")
    def meaning(self) -> str:
        """What the cause is, as a sentence."""
        moved = direction_words({name: x.value for name, x in self.parameters.items()})
        return moved or (FACTS[self.name].sentence if self.name in FACTS else OF_THE_CALLER)

    @property
    @derived("Where its plausible size comes from")
    def source(self) -> str:
        """Where its plausible size comes from."""
        return FACTS[self.name].source if self.name in FACTS else OF_THE_CALLER


def posterior_of(refit: Refit) -> Laplace:
    """Intervals of all parameters of a fit."""
    fitted = refit.fitted
    return laplace(fitted.evaluation, fitted.model.parameters, fitted.noise.factor)


def causes_of(refit: Refit) -> tuple[Cause, ...]:
    """The causes that a fit has beyond the base model, with their amplitudes.

    For amplitudes in one unit that may have either sign, such as the components of a force, the
    total counts: the root of the sum of their squares, less what their errors add to it. Of others
    in the unit of the first, such as the stiffnesses of two halves, the largest counts.
    """
    posterior, covariance = posterior_of(refit), refit.covariance()
    return tuple(_cause(refit, x, posterior, covariance) for x in refit.names)


def ligament_estimates(refit: Refit) -> dict[str, dict[str, Estimate]]:
    """The calibrated parameters of a fit by ligament and quantity."""
    posterior = posterior_of(refit)
    n = refit.fitted.model.n_ligament_parameters
    tree: dict[str, dict[str, Estimate]] = {}
    for i, name in enumerate(refit.fitted.model.parameters.names[:n]):
        found = _estimate(name, i, posterior)
        tree.setdefault(name.rpartition(".")[0], {})[found.name] = found
    return tree


def _cause(refit: Refit, name: str, posterior: Laplace, covariance: np.ndarray) -> Cause:
    parameters, places = refit.fitted.model.parameters, refit.places(name)
    found = tuple(_estimate(parameters.names[i], int(i), posterior) for i in places)
    unit = found[0].unit
    # Plain numbers are not alike for having no unit.
    same = [k for k, x in enumerate(found) if k == 0 or x.unit == unit != PLAIN]
    if len(same) == len(found) > 1 and np.all(parameters.lower[places] < 0.0):
        amplitude = _total(found, covariance[np.ix_(places, places)], parameters.prior_sd[places])
    else:
        amplitude = reduce(lambda x, y: y if y.value > x.value else x, [found[k] for k in same])
    return Cause(
        name=name,
        amplitude=amplitude.value,
        unit=amplitude.unit,
        ci95=amplitude.ci95,
        parameter=amplitude.name,
        parameters={x.name: x for x in found},
        line=_line(refit, name),
    )


def _line(refit: Refit, name: str) -> LineEnds | None:
    """Where the line of a structure runs with the shifts found."""
    knee = refit.fitted.model.knee
    effect = next(x for x in refit.causes if x.name == name)
    if not isinstance(effect, MissingStructure) or len(effect.femoral) > 1:
        return None
    femoral, tibial = effect.insertions(refit.amplitudes(name))
    ends = np.vstack([knee.femur_frame.to_common(femoral), knee.tibia_frame.to_common(tibial)])
    return LineEnds.of(ends, knee)


def _total(
    components: tuple[Estimate, ...], covariance: np.ndarray, prior_sd: np.ndarray
) -> Estimate:
    """Length of a vector, its interval to first order, the lower end by what errors add to it.

    Errors of the components make the length found too long: its square is expected to be that of
    the true length and the sum of the variances that noise alone gives them.
    """
    values = np.array([x.value for x in components])
    square = float(values @ values)
    along = float(values @ covariance @ values) / square if square > 0.0 else 0.0
    # What the prior adds to the uncertainty does not scatter the values found.
    scatter = covariance - covariance @ np.diag(prior_sd**-2.0) @ covariance
    middle = max(square - float(np.trace(scatter)), 0.0)
    reach = TWO_SIDED * np.sqrt(along)
    low, high = max(np.sqrt(middle) - reach, 0.0), np.sqrt(square) + reach
    # A component without a limit leaves the length without one.
    is_open = any(None in x.ci95 for x in components)
    is_unknown = any(x.ci95 == (None, None) for x in components)
    return Estimate(
        name=TOTAL,
        value=float(np.sqrt(middle)),
        unit=components[0].unit,
        ci95=(None if is_unknown else float(low), None if is_open else float(high)),
    )


def _estimate(name: str, i: int, posterior: Laplace) -> Estimate:
    return Estimate(
        name=name.rpartition(".")[2],
        value=float(posterior.theta[i]),
        unit=unit_of(name),
        ci95=posterior.interval(i),
    )
