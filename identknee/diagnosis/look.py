"""One look at what a fit leaves, and the refits with the effects that score high."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identknee.diagnosis.base_fit import fitted_to_low_loads
from identknee.diagnosis.library_signatures import Variant
from identknee.diagnosis.refit import Refit, refit
from identknee.diagnosis.rivals import could_matter, is_undecided
from identknee.diagnosis.score import CandidateScore, Scores, ScoreTest
from identknee.model.effects.effect import Effect
from identknee.runs.arrays import Array
from identknee.runs.outcome import Outcome

# What the highest score may be by chance for a first cause, and for one more: a cause found shifts
# what is left, and its own model is only nearly right.
LEVEL, FURTHER_LEVEL = 0.05, 0.01
# Refitted at each step: those that score highest, and how low a score is still worth it.
MOST_REFITS = 8
LEAST_SCORE = 1.0
# An effect with more can imitate most others, alone or together, and is no first choice.
MOST_AMPLITUDES = 16
# Steps before those far behind in evidence are left where they are; the highest scores never are.
FEW_STEPS, FAR_BEHIND, ALWAYS = 6, 40.0, 2
# Of the amplitude expected: where a refit begins that can begin nowhere else.
LITTLE = 0.1
# The same where even that has no prediction, from more to nearly nothing.
LESS = (0.03, 0.01, 0.001)
# The best other refits from whose ligaments one begins that failed.
MOST_HELPERS = 2


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


def promising_refits(step: Step, base: Refit) -> tuple[Refit, ...]:
    """The effects that score high, refitted: all a little, the better ones to the end.

    One that has no prediction, or is stuck where a trial leaves its branch, begins again with less
    of the effect and from the ligaments of refits that succeeded, before it is given up.

    Returns
    -------
    tuple of Refit
        The highest evidence first.
    """
    tasks = [_Task.of(step, x, base) for x in _promising(step)]
    begun = [x.begun(base) for x in tasks]
    best = max((x.log_evidence for x in begun), default=0.0)
    found = [
        task.finished(base, x) if place < ALWAYS or x.log_evidence > best - FAR_BEHIND else x
        for place, (task, x) in enumerate(zip(tasks, begun, strict=True))
    ]
    best = max((x.log_evidence for x in found), default=0.0)
    for place, task in enumerate(tasks):
        if task.is_possible and is_undecided(found[place], best - found[place].log_evidence):
            found[place] = task.rescued(base, found[place], found)
    return tuple(sorted(found, key=lambda x: -x.log_evidence))


def is_flexible(effect: Effect) -> bool:
    """Whether an effect has so many amplitudes that it can imitate most others."""
    return effect.parameters.n > MOST_AMPLITUDES


def _promising(step: Step) -> list[CandidateScore]:
    found_high = [x for x in step.scores.candidates if x.score > LEAST_SCORE]
    if step.at.causes:
        by_name = {x.effect.name: x.effect for x in step.variants}
        found_high = [x for x in found_high if not is_flexible(by_name[x.name])]
    unseen = {x.effect.name for x in step.variants if x.is_secant and not step.at.causes}
    return found_high[:MOST_REFITS] + [x for x in found_high[MOST_REFITS:] if x.name in unseen]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Task:
    """One effect to join the model.

    Attributes
    ----------
    causes
        All effects of the model then, this one last.
    starts
        Where its refit begins, the most promising place first.
    faint
        Where it begins if none of those has a prediction.
    values
        Amplitudes that the score expects.
    is_possible
        Whether its score leaves it possible that it is the explanation.
    """

    causes: tuple[Effect, ...]
    starts: tuple[Array, ...]
    faint: tuple[Array, ...]
    values: Array
    is_possible: bool

    @classmethod
    def of(cls, step: Step, candidate: CandidateScore, base: Refit) -> "_Task":
        variant = next(
            x
            for x in step.variants
            if x.signature.name == candidate.name and x.signature.variant == candidate.variant
        )
        values = variant.start(candidate.amplitude)
        theta = step.at.fitted.theta
        return cls(
            causes=(*step.at.causes, variant.effect),
            starts=tuple(_starts(step.at, variant, values, base)),
            faint=tuple(np.r_[theta, _share(variant, values, x)] for x in LESS),
            values=values,
            is_possible=could_matter(candidate, step.scores.max_score),
        )

    def begun(self, base: Refit) -> Refit:
        """A few steps from the first start that has a prediction."""
        for start in (*self.starts, *self.faint):
            first = refit(base, self.causes, [start], most_steps=FEW_STEPS)
            if first.fitted.evaluation.is_finite:
                break
        return first

    def finished(self, base: Refit, begun: Refit) -> Refit:
        """A refit taken to its end, by way of low loads where it is stuck."""
        starts = self.starts[1:]
        begins = [begun.fitted.theta, *starts]
        if not is_flexible(self.causes[-1]):
            # Few amplitudes have few minima: what is ahead after a few steps ends lowest.
            tried = [refit(base, self.causes, [x], most_steps=FEW_STEPS) for x in starts]
            begins = [min([begun, *tried], key=lambda x: x.fitted.deviance).fitted.theta]
        found = refit(base, self.causes, begins)
        if found.fitted.outcome is Outcome.MINIMUM:
            return found
        return max(found, _by_low_loads(base, found, starts[-1]), key=lambda x: x.log_evidence)

    def rescued(self, base: Refit, found: Refit, all_found: Sequence[Refit]) -> Refit:
        """A refit that failed, is stuck or was left, begun again also where others succeeded."""
        helpers = [x for x in all_found if x is not found and x.fitted.evaluation.is_finite]
        helpers = sorted(helpers, key=lambda x: -x.log_evidence)[:MOST_HELPERS]
        sizes = [self.values]
        if found.fitted.evaluation.is_finite:
            sizes.append(found.fitted.theta[-len(self.values) :])
        n_base, n = base.n_base, len(self.starts[0]) - len(self.values)
        others = self.starts[1][n_base:n]
        tried = [self.finished(base, found)]
        tried += [
            refit(base, self.causes, [np.r_[x.fitted.theta[:n_base], others, size]])
            for x in helpers
            for size in sizes
        ]
        return max([found, *tried], key=lambda x: x.log_evidence)


def _by_low_loads(base: Refit, found: Refit, start: Array) -> Refit:
    fitted = found.fitted
    low = fitted_to_low_loads(fitted.model, fitted.laxity, fitted.noise, start)
    return refit(base, found.causes, [low])


def _starts(at: Refit, variant: Variant, values: Array, base: Refit) -> list[Array]:
    """Where a refit begins, the most promising place first.

    Where the score expects it, the fit there is, the subject's own values; the fit there is with
    little of the effect.
    """
    evaluation = at.fitted.evaluation
    # What the effect does to the predictions, the fitted parameters had taken on themselves.
    shift = np.zeros(len(evaluation.residuals))
    shift[: at.fitted.n_data] = variant.signature.columns @ (values - variant.values)[variant.moved]
    moved = np.linalg.lstsq(evaluation.jacobian, -evaluation.residuals - shift, rcond=None)[0]
    p = at.fitted.model.parameters
    near = np.clip(at.fitted.theta + moved, p.lower, p.upper)
    own = np.r_[base.fitted.model.parameters.center, at.fitted.theta[base.n_base :]]
    return [np.r_[x, values] for x in (near, at.fitted.theta, own)] + [
        np.r_[at.fitted.theta, _share(variant, values, LITTLE)]
    ]


def _share(variant: Variant, values: Array, share: float) -> Array:
    """So much of the way from no effect to `values`."""
    part = np.array(variant.values)
    part[variant.moved] += share * (values - variant.values)[variant.moved]
    return part
