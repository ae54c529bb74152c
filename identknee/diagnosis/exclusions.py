"""What a diagnosis says of every effect of the library: seen, excluded, or beyond its power."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.causes import PLAIN, explanation_of, unit_of
from identknee.diagnosis.diagnose import Diagnosis
from identknee.diagnosis.library_signatures import Variant
from identknee.diagnosis.look import LEVEL, Step
from identknee.diagnosis.power import Cell, detectable_amplitude, detection_power, judge
from identknee.diagnosis.score import ScoreTest
from identknee.model.effects.effect import Effect
from identknee.model.effects.facts import FACTS
from identknee.model.effects.library import library


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exclusion:
    """One effect beside the data.

    Attributes
    ----------
    name
        Of the effect.
    cell
        What the data say of it.
    score, p_value
        Of its score and the probability of a largest score as high by chance.
    parameter, unit
        The amplitude that the rest is about: of those in the unit of the first, the hardest to see.
    detectable
        Its size that the test finds in nine of ten data sets; infinite where it never does.
    relevant
        The smallest size worth knowing.
    power
        How often the test finds that size.
    """

    name: str
    cell: Cell
    score: float
    p_value: float
    parameter: str
    unit: str
    detectable: float
    relevant: float
    power: float


def exclusions(found: Diagnosis) -> tuple[Exclusion, ...]:
    """What a diagnosis says of each effect of the library.

    Effects in the explanation have the score that they had before they joined it, all others the
    score beside it. A missing structure counts at the site where anatomy puts it, with an ordinary
    strain.
    """
    first, *others = found.attribution.steps
    explanation = explanation_of(found)
    beside = next((x for x in others if x.at is explanation), first)
    laxity = found.laxity
    effects = library(
        found.base.fitted.model.knee,
        has_order=laxity.order is not None,
        has_phase=laxity.phase is not None,
    )
    return tuple(_exclusion(first if x.name in explanation.names else beside, x) for x in effects)


def _exclusion(step: Step, effect: Effect) -> Exclusion:
    relevant = FACTS[effect.name].relevant
    own = [x for x in step.variants if x.effect.name == effect.name]
    if not own:
        name = effect.parameters.names[0]
        return Exclusion(
            name=effect.name,
            cell=Cell.INCONCLUSIVE,
            score=0.0,
            p_value=1.0,
            parameter=name.partition(".")[2],
            unit=unit_of(name),
            detectable=float("inf"),
            relevant=relevant,
            power=LEVEL,
        )
    score = step.scores.named(effect.name)
    name, detectable, power = hardest(step.test, typical_variant(own), relevant)
    return Exclusion(
        name=effect.name,
        cell=judge(is_significant=score.p_value <= LEVEL, power=power),
        score=score.score,
        p_value=score.p_value,
        parameter=name.partition(".")[2],
        unit=unit_of(name),
        detectable=detectable,
        relevant=relevant,
        power=power,
    )


def hardest(test: ScoreTest, variant: Variant, relevant: float) -> tuple[str, float, float]:
    """Of the amplitudes in the unit of the first the one hardest to see.

    Its name, its size that is found in nine of ten data sets, and how often `relevant` is found.
    """
    signature = test.signature(variant.signature.name, variant.signature.variant)
    names = [variant.effect.parameters.names[i] for i in variant.moved]
    unit = unit_of(names[0])
    # Plain numbers are not alike for having no unit.
    alike = [k for k, x in enumerate(names) if k == 0 or unit_of(x) == unit != PLAIN]
    least = min(alike, key=lambda k: signature.gram[k, k])
    amplitude = np.zeros(len(names))
    amplitude[least] = relevant * (signature.signature.sign[least] or 1)
    return (
        names[least],
        detectable_amplitude(test, signature, least),
        detection_power(test, signature, amplitude),
    )


def typical_variant(variants: Iterable[Variant]) -> Variant:
    """Of the variants of one effect the one taken at the least unusual amplitudes."""
    return min(variants, key=_distance_from_prior)


def _distance_from_prior(variant: Variant) -> float:
    p = variant.effect.parameters
    return float(np.sum(((variant.values - p.center) / p.prior_sd) ** 2))
