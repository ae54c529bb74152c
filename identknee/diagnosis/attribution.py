"""Which causes a misfit speaks for: effects join the model one by one, each with its rivals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.diagnosis.candidates import CandidateCauses, Variant, library_candidates
from identknee.diagnosis.refit import (
    Refit,
    Rival,
    RivalState,
    could_matter,
    is_undecided,
    refit,
    refit_via_low_loads,
    rivals_of,
)
from identknee.diagnosis.score import LEVEL, CandidateScore, Scores
from identknee.model.effects.effect import Effect
from identknee.runs.arrays import Array
from identknee.runs.declare import declared, entry
from identknee.runs.progress import counted, progress, progress_bar, stage
from identknee.runs.record import Outcome

MOST_CAUSES = 3
# Log evidence that a cause must gain to join, and to stay when another could do without it.
LEAST_GAIN = 2.0
# Fall of the penalised chi-square that the largest of a library of scores reaches by chance.
LEAST_FALL, FURTHER_FALL = 9.0, 16.0
# What the highest score may be by chance for a first cause, and for one more: a cause found shifts
# what is left, and its own model is only nearly right.
FURTHER_LEVEL = 0.01
# Refitted at each step: those that score highest, and how low a score is still worth it.
MOST_REFITS = 8
LEAST_SCORE = 1.0
# An effect with more can imitate most others, alone or together, and is no first choice.
MOST_AMPLITUDES = 16
# Steps before those far behind in evidence are left where they are; the highest scores never are.
FEW_STEPS, FAR_BEHIND, ALWAYS = 6, 40.0, 2
# Share of the amplitude expected at which a refit begins that can begin nowhere else.
LITTLE = 0.1
# The same where even that has no prediction, from more to nearly nothing.
LESS = (0.03, 0.01, 0.001)
# Seconds that it takes to finish the refit of a simple effect, and of one with many amplitudes
# that a straight model promises to fit better by more than NEARLY_DONE.
SIMPLE, FAR_FROM_DONE, NEARLY_DONE = 0.14, 4.0, 1.0
# The best other refits from whose ligaments one begins that failed.
MOST_HELPERS = 2


@declared
class AttributionStep(CandidateCauses):
    """The scores at one fit, and the refits they suggest."""

    at: Refit = entry("The fit")
    scores: Scores = entry("How strongly it speaks for each effect that is not in it")
    refits: tuple[Refit, ...] = entry(
        "The fit extended by each promising effect, the highest evidence first"
    )

    @property
    def is_significant(self) -> bool:
        """Whether some effect scores higher than chance allows."""
        return self.scores.p_value <= (FURTHER_LEVEL if self.at.causes else LEVEL)


@declared
class Attribution:
    """The best explanation of a misfit, and its alternatives."""

    steps: tuple[AttributionStep, ...] = entry(
        "The looks taken, from the base model on; the last at the best explanation"
    )
    best: Refit = entry("The model with all causes found; the base model where there is none")
    rivals: tuple[Rival, ...] = entry(
        "Other explanations with as many causes, the most likely first"
    )

    @property
    def base(self) -> Refit:
        """The model without causes."""
        return self.steps[0].at

    @property
    def has_remaining_misfit(self) -> bool:
        """Whether an effect not in the best explanation still scores higher than chance allows."""
        last = self.steps[-1]
        return last.at is self.best and last.is_significant

    @property
    def open_rivals(self) -> tuple[Rival, ...]:
        """The rivals that are not excluded."""
        return tuple(x for x in self.rivals if x.state is RivalState.OPEN)

    @property
    def untested_rivals(self) -> tuple[Rival, ...]:
        """The rivals that could not be fitted but are possible by their score."""
        return tuple(x for x in self.rivals if x.state is RivalState.NOT_TESTED and x.could_matter)


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
        Seed of the distribution of the largest score.
    is_forced
        Whether to try a first cause although none scores high: where other tests found a misfit.
    """
    current, steps = base, [score_candidates(base, effects, seed)]
    rest: tuple[Refit, ...] = ()
    while len(current.causes) < MOST_CAUSES:
        step = steps[-1]
        if not (step.is_significant or (is_forced and not current.causes)):
            break
        step = replace(step, refits=refit_top_candidates(step, base))
        steps[-1] = step
        simple = [x for x in step.refits if not is_flexible(x.causes[-1])]
        if not simple or not _is_better(simple[0], current):
            break
        current, rest = simple[0], step.refits
        left = [x for x in effects if x.name not in current.names]
        if not left:
            break
        steps.append(score_candidates(current, left, seed))
    current, rest = backward_elimination(base, current, rest, steps)
    current, rest = _with_flexible_effects(current, rest, steps[0])
    left = [x for x in effects if x.name not in current.names]
    if left and steps[-1].at is not current:
        steps.append(score_candidates(current, left, seed))
    rivals = rivals_of(current, rest, [(x.at, x.scores) for x in steps])
    return Attribution(steps=tuple(steps), best=current, rivals=rivals)


def score_candidates(at: Refit, effects: Sequence[Effect], seed: int) -> AttributionStep:
    """The scores of effects at a fit, before any refit.

    Parameters
    ----------
    at
        The fit.
    effects
        The effects not in it.
    seed
        Seed of the distribution of the largest score.
    """
    with stage("scoring causes"):
        found = library_candidates(at.fitted, effects, seed=seed)
        scores = found.test.evaluate(at.fitted.residual_rows())
    return AttributionStep(
        at=at, variants=found.variants, test=found.test, scores=scores, refits=()
    )


def _is_better(new: Refit, old: Refit) -> bool:
    """Whether `new` is worth its causes: the data must say so, and the prior not forbid it."""
    fall = old.penalised_chi2 - new.penalised_chi2
    least = FURTHER_FALL if old.causes else LEAST_FALL
    return fall > least and new.log_evidence > old.log_evidence + LEAST_GAIN


def backward_elimination(
    base: Refit, current: Refit, rest: tuple[Refit, ...], steps: Sequence[AttributionStep]
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
            if x.names[0] not in current.names and not is_flexible(x.causes[0])
        ]
        alternatives += [_swapped(base, current, cause.name, x) for x in others[:4]]
    best = max([current, *alternatives], key=lambda x: x.log_evidence)
    if best is current or not _is_better(best, current):
        simpler = [x for x in alternatives if len(x.causes) < len(current.causes)]
        enough = [x for x in simpler if not _is_better(current, x)]
        best = max(enough, key=lambda x: x.log_evidence) if enough else current
    return best, tuple(x for x in (current, *alternatives) if x is not best)


def _with_flexible_effects(
    current: Refit, rest: tuple[Refit, ...], first: AttributionStep
) -> tuple[Refit, tuple[Refit, ...]]:
    """The explanation beside effects that fit almost anything, which win by evidence alone."""
    flexible = [x for x in first.refits if is_flexible(x.causes[-1])]
    rest = (*(rest or first.refits), *(x for x in flexible if rest and x not in rest))
    best = max([current, *flexible], key=lambda x: x.log_evidence)
    if best is current or not _is_better(best, first.at):
        return current, rest
    return best, tuple(x for x in (current, *rest) if x is not best and x.causes)


def _without(base: Refit, current: Refit, name: str) -> Refit:
    kept = [x for x in current.causes if x.name != name]
    theta = np.delete(current.fitted.theta, list(current.places(name)))
    return refit(base, kept, [theta])


def _swapped(base: Refit, current: Refit, name: str, single: Refit) -> Refit:
    kept = [x for x in current.causes if x.name != name]
    theta = np.delete(current.fitted.theta, list(current.places(name)))
    start = np.r_[theta, single.amplitudes(single.names[0])]
    return refit(base, [*kept, *single.causes], [start])


def refit_top_candidates(step: AttributionStep, base: Refit) -> tuple[Refit, ...]:
    """The effects that score high, refitted: all a little, the better ones to the end.

    One that has no prediction, or is stuck where a trial leaves its branch, begins again with less
    of the effect and from the ligaments of refits that succeeded, before it is given up.

    Returns
    -------
    tuple of Refit
        The highest evidence first.
    """
    tasks = [_Task.of(step, x, base) for x in _promising(step)]
    begun = [x.begun(base) for x in progress(tasks, description="trying causes")]
    best = max((x.log_evidence for x in begun), default=0.0)
    costs = [task.cost(x) for task, x in zip(tasks, begun, strict=True)]
    with progress_bar("fitting causes", len(costs), costs=costs) as advance:
        found = [
            task.finished(base, x) if place < ALWAYS or x.log_evidence > best - FAR_BEHIND else x
            for place, (task, x) in counted(enumerate(zip(tasks, begun, strict=True)), advance)
        ]
    best = max((x.log_evidence for x in found), default=0.0)
    for place, task in enumerate(tasks):
        if task.is_possible and is_undecided(found[place], best - found[place].log_evidence):
            found[place] = task.rescued(base, found[place], found)
    return tuple(sorted(found, key=lambda x: -x.log_evidence))


def is_flexible(effect: Effect) -> bool:
    """Whether an effect has so many amplitudes that it can imitate most others."""
    return effect.parameters.n > MOST_AMPLITUDES


def _promising(step: AttributionStep) -> list[CandidateScore]:
    found_high = [x for x in step.scores.candidates if x.score > LEAST_SCORE]
    if step.at.causes:
        by_name = {x.effect.name: x.effect for x in step.variants}
        found_high = [x for x in found_high if not is_flexible(by_name[x.name])]
    unseen = {x.effect.name for x in step.variants if x.is_secant and not step.at.causes}
    return found_high[:MOST_REFITS] + [x for x in found_high[MOST_REFITS:] if x.name in unseen]


@declared
class _Task:
    """One effect to join the model."""

    causes: tuple[Effect, ...] = entry("All effects of the model then, this one last")
    starts: tuple[Array, ...] = entry("Where its refit begins, the most promising place first")
    faint: tuple[Array, ...] = entry("Where it begins if none of those has a prediction")
    values: Array = entry("Amplitudes that the score expects")
    is_possible: bool = entry("Whether its score leaves it possible that it is the explanation")

    @classmethod
    def of(cls, step: AttributionStep, candidate: CandidateScore, base: Refit) -> "_Task":
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

    def cost(self, begun: Refit) -> float:
        """What it takes to finish a refit, beside those of other effects."""
        is_far = is_flexible(self.causes[-1]) and begun.promised_fall > NEARLY_DONE
        return FAR_FROM_DONE if is_far else SIMPLE

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
        if is_flexible(self.causes[-1]):
            found = refit(base, self.causes, [begun.fitted.theta, *starts])
        else:
            # Few amplitudes have few minima: what is ahead after a few steps ends lowest.
            tried = [begun]
            for x in starts:
                tried.append(refit(base, self.causes, [x], most_steps=FEW_STEPS, beside=tried))
            found = min(tried, key=lambda x: x.fitted.deviance)
            if found.fitted.outcome is not Outcome.MINIMUM:
                found = refit(base, self.causes, [found.fitted.theta])
        if found.fitted.outcome is Outcome.MINIMUM:
            return found
        return max(
            found, refit_via_low_loads(base, found, starts[-1]), key=lambda x: x.log_evidence
        )

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


def _starts(at: Refit, variant: Variant, values: Array, base: Refit) -> list[Array]:
    """Start points of a refit, the most promising first.

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
    """Interpolation between no effect and `values`."""
    part = np.array(variant.values)
    part[variant.moved] += share * (values - variant.values)[variant.moved]
    return part
