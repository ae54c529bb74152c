"""Which causes a misfit speaks for: effects join the model one by one, each with its rivals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identknee.diagnosis.base_fit import fitted_to_low_loads
from identknee.diagnosis.library_signatures import Variant, library_variants
from identknee.diagnosis.refit import Refit, expected_distance, refit
from identknee.diagnosis.score import Scores, ScoreTest, score_test
from identknee.model.effects.effect import Effect
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome

# What the highest score may be by chance for a first cause, and for one more: a cause found shifts
# what is left, and its own model is only nearly right.
LEVEL, FURTHER_LEVEL = 0.05, 0.01
MOST_CAUSES = 3
# Refitted at each step: those that score highest, and how low a score is still worth it.
MOST_REFITS = 8
LEAST_SCORE = 1.0
# An effect with more can imitate most others, alone or together, and is no first choice.
MOST_AMPLITUDES = 16
# Steps before those far behind in evidence are left where they are; the highest scores never are.
FEW_STEPS, FAR_BEHIND, ALWAYS = 6, 40.0, 2
# Of the amplitude expected: where a refit begins that can begin nowhere else.
LITTLE = 0.1
# Of the logarithm of the evidence: what a cause must gain to join, and to stay when another could
# do without it.
LEAST_GAIN = 2.0
# Of the chi-square: what the largest of a library of scores reaches by chance, squared.
LEAST_FALL, FURTHER_FALL = 9.0, 16.0
# A rival this much less likely is excluded if it could be told apart; beyond the second number
# whether it could or not.
NEAR_EVIDENCE, FAR_EVIDENCE = 6.0, 10.0
LEAST_DISTANCE = 5.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """One look at what a fit leaves.

    Attributes
    ----------
    at
        The fit.
    variants
        Signatures of the effects not in it.
    test
        The max-score test of them.
    scores
        What it found.
    refits
        The fit extended by each promising effect, the highest evidence first.
    """

    at: Refit
    variants: tuple[Variant, ...]
    test: ScoreTest
    scores: Scores
    refits: tuple[Refit, ...]

    @property
    def is_significant(self) -> bool:
        """Whether some effect scores higher than chance allows."""
        return self.scores.p_value <= (FURTHER_LEVEL if self.at.causes else LEVEL)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rival:
    """Another explanation.

    Attributes
    ----------
    refit
        The model with it.
    lead
        By how much the logarithm of its evidence is lower than that of the best explanation.
    distance
        How well the data could tell both apart, see `expected_distance`.
    """

    refit: Refit
    lead: float
    distance: float

    @property
    def is_excluded(self) -> bool:
        """Whether the data speak against it clearly enough."""
        if self.lead > FAR_EVIDENCE:
            return True
        return self.lead > NEAR_EVIDENCE and self.distance > LEAST_DISTANCE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Attribution:
    """The best explanation of a misfit, and what could stand in its place.

    Attributes
    ----------
    steps
        The looks taken, from the base model on; the last at the best explanation.
    best
        The model with all causes found; the base model where there is none.
    rivals
        Other explanations with as many causes, the most likely first.
    """

    steps: tuple[Step, ...]
    best: Refit
    rivals: tuple[Rival, ...]

    @property
    def base(self) -> Refit:
        """The model without causes."""
        return self.steps[0].at

    @property
    def is_left_unexplained(self) -> bool:
        """Whether an effect not in the best explanation still scores higher than chance allows."""
        last = self.steps[-1]
        return last.at is self.best and last.is_significant

    @property
    def open_rivals(self) -> tuple[Rival, ...]:
        """Those that the data do not exclude."""
        return tuple(x for x in self.rivals if not x.is_excluded)


def attribute(
    base: Refit, effects: Sequence[Effect], *, seed: int, is_forced: bool = False
) -> Attribution:
    """The explanation of what a fit leaves: forward steps, then a look back and at swaps.

    At each step the effects that score highest join the model in turn; the one with most evidence
    stays. It ends when no further effect scores higher than chance allows, when none gains
    evidence or at three causes.

    Parameters
    ----------
    base
        The fit without causes.
    effects
        Candidates.
    seed
        Of the distribution of the largest score.
    is_forced
        Whether to try a first cause although none scores high: where other tests found a misfit.
    """
    current, steps = base, [_look(base, effects, seed)]
    rest: tuple[Refit, ...] = ()
    while len(current.causes) < MOST_CAUSES:
        step = steps[-1]
        if not (step.is_significant or (is_forced and not current.causes)):
            break
        step = _with_refits(step, base)
        steps[-1] = step
        simple = [x for x in step.refits if not _is_flexible(x.causes[-1])]
        if not simple or not _is_better(simple[0], current):
            break
        current, rest = simple[0], step.refits
        left = [x for x in effects if x.name not in current.names]
        if not left:
            break
        steps.append(_look(current, left, seed))
    current, rest = _looked_back(base, current, rest, steps)
    current, rest = _with_flexible(current, rest, steps[0])
    left = [x for x in effects if x.name not in current.names]
    if left and steps[-1].at is not current:
        steps.append(_look(current, left, seed))
    return Attribution(steps=tuple(steps), best=current, rivals=_rivals(current, rest))


def _look(at: Refit, effects: Sequence[Effect], seed: int) -> Step:
    variants = library_variants(at.fitted, effects)
    test = score_test(at.projector, [x.signature for x in variants], seed=seed, scale="unknown")
    scores = test.evaluate(at.fitted.residual_rows())
    return Step(at=at, variants=variants, test=test, scores=scores, refits=())


def _with_refits(step: Step, base: Refit) -> Step:
    """The step with its promising effects refitted: all a little, the better ones to the end."""
    found_high = [x for x in step.scores.candidates if x.score > LEAST_SCORE]
    if step.at.causes:
        by_name = {x.effect.name: x.effect for x in step.variants}
        found_high = [x for x in found_high if not _is_flexible(by_name[x.name])]
    unseen = {x.effect.name for x in step.variants if x.is_secant and not step.at.causes}
    promising = found_high[:MOST_REFITS] + [x for x in found_high[MOST_REFITS:] if x.name in unseen]
    begun = []
    for candidate in promising:
        variant = next(
            x
            for x in step.variants
            if x.signature.name == candidate.name and x.signature.variant == candidate.variant
        )
        causes = (*step.at.causes, variant.effect)
        starts = _starts(step.at, variant, candidate.amplitude, base)
        for number in range(len(starts)):
            first = refit(base, causes, starts[number : number + 1], most_steps=FEW_STEPS)
            if first.fitted.evaluation.is_finite:
                break
        begun.append((first, starts[1:]))
    best = max((x.log_evidence for x, _ in begun), default=0.0)
    found = [
        _finished(base, x, starts) if place < ALWAYS or x.log_evidence > best - FAR_BEHIND else x
        for place, (x, starts) in enumerate(begun)
    ]
    return replace(step, refits=tuple(sorted(found, key=lambda x: -x.log_evidence)))


def _finished(base: Refit, begun: Refit, starts: Sequence[Array]) -> Refit:
    """A refit taken to its end, by way of low loads where it is stuck."""
    begins = [begun.fitted.theta, *starts]
    if not _is_flexible(begun.causes[-1]):
        # Few amplitudes have few minima: what is ahead after a few steps ends lowest.
        tried = [refit(base, begun.causes, [x], most_steps=FEW_STEPS) for x in starts]
        begins = [min([begun, *tried], key=lambda x: x.fitted.deviance).fitted.theta]
    found = refit(base, begun.causes, begins)
    fitted = found.fitted
    if fitted.outcome is Outcome.MINIMUM:
        return found
    low = fitted_to_low_loads(fitted.model, fitted.laxity, fitted.noise, starts[-1])
    again = refit(base, begun.causes, [low])
    return max(found, again, key=lambda x: x.log_evidence)


def _starts(at: Refit, variant: Variant, amplitude: Array, base: Refit) -> list[Array]:
    """Where a refit begins, the most promising place first.

    Where the score expects it, the fit there is, the subject's own values; the fit there is with
    little of the effect.
    """
    values = variant.start(amplitude)
    evaluation = at.fitted.evaluation
    # What the effect does to the predictions, the fitted parameters had taken on themselves.
    shift = np.zeros(len(evaluation.residuals))
    shift[: at.fitted.n_data] = variant.signature.columns @ (values - variant.values)[variant.moved]
    moved = np.linalg.lstsq(evaluation.jacobian, -evaluation.residuals - shift, rcond=None)[0]
    p = at.fitted.model.parameters
    near = np.clip(at.fitted.theta + moved, p.lower, p.upper)
    own = np.r_[base.fitted.model.parameters.center, at.fitted.theta[base.n_base :]]
    little = np.array(variant.values)
    little[variant.moved] += LITTLE * (values - variant.values)[variant.moved]
    return [np.r_[x, values] for x in (near, at.fitted.theta, own)] + [
        np.r_[at.fitted.theta, little]
    ]


def _is_better(new: Refit, old: Refit) -> bool:
    """Whether `new` is worth its causes: the data must say so, and the prior not forbid it."""
    fall = old.strain - new.strain
    least = FURTHER_FALL if old.causes else LEAST_FALL
    return fall > least and new.log_evidence > old.log_evidence + LEAST_GAIN


def _looked_back(
    base: Refit, current: Refit, rest: tuple[Refit, ...], steps: Sequence[Step]
) -> tuple[Refit, tuple[Refit, ...]]:
    """The explanation after leaving out and swapping single causes, and its alternatives."""
    if len(current.causes) < 2:
        return current, rest
    alternatives = list(rest)
    for cause in current.causes:
        alternatives.append(_without(base, current, cause.name))
        others = [
            x
            for x in steps[0].refits
            if x.names[0] not in current.names and not _is_flexible(x.causes[0])
        ]
        alternatives += [_swapped(base, current, cause.name, x) for x in others[:4]]
    best = max([current, *alternatives], key=lambda x: x.log_evidence)
    if best is current or not _is_better(best, current):
        simpler = [x for x in alternatives if len(x.causes) < len(current.causes)]
        enough = [x for x in simpler if not _is_better(current, x)]
        best = max(enough, key=lambda x: x.log_evidence) if enough else current
    return best, tuple(x for x in (current, *alternatives) if x is not best)


def _with_flexible(
    current: Refit, rest: tuple[Refit, ...], first: Step
) -> tuple[Refit, tuple[Refit, ...]]:
    """The explanation beside effects that fit almost anything, which win by evidence alone."""
    flexible = [x for x in first.refits if _is_flexible(x.causes[-1])]
    rest = (*(rest or first.refits), *(x for x in flexible if rest and x not in rest))
    best = max([current, *flexible], key=lambda x: x.log_evidence)
    if best is current or not _is_better(best, first.at):
        return current, rest
    return best, tuple(x for x in (current, *rest) if x is not best and x.causes)


def _is_flexible(effect: Effect) -> bool:
    return effect.parameters.n > MOST_AMPLITUDES


def _without(base: Refit, current: Refit, name: str) -> Refit:
    kept = [x for x in current.causes if x.name != name]
    theta = np.delete(current.fitted.theta, list(current.places(name)))
    return refit(base, kept, [theta])


def _swapped(base: Refit, current: Refit, name: str, single: Refit) -> Refit:
    kept = [x for x in current.causes if x.name != name]
    theta = np.delete(current.fitted.theta, list(current.places(name)))
    start = np.r_[theta, single.amplitudes(single.names[0])]
    return refit(base, [*kept, *single.causes], [start])


def _rivals(best: Refit, rest: Sequence[Refit]) -> tuple[Rival, ...]:
    """The other explanations, each set of causes once, the most likely first."""
    found: dict[frozenset[str], Refit] = {}
    for x in sorted(rest, key=lambda x: -x.log_evidence):
        if set(x.names) != set(best.names):
            found.setdefault(frozenset(x.names), x)
    return tuple(_rival(best, x) for x in found.values())


def _rival(best: Refit, other: Refit) -> Rival:
    return Rival(
        refit=other,
        lead=best.log_evidence - other.log_evidence,
        distance=expected_distance(best, other),
    )
