"""Which causes a misfit speaks for: effects join the model one by one, each with its rivals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identknee.diagnosis.library_signatures import library_variants
from identknee.diagnosis.look import Step, is_flexible, promising_refits
from identknee.diagnosis.refit import Refit, refit
from identknee.diagnosis.rivals import Rival, RivalState, rivals_of
from identknee.diagnosis.score import score_test
from identknee.model.effects.effect import Effect

MOST_CAUSES = 3
# Of the logarithm of the evidence: what a cause must gain to join, and to stay when another could
# do without it.
LEAST_GAIN = 2.0
# Of the chi-square: what the largest of a library of scores reaches by chance, squared.
LEAST_FALL, FURTHER_FALL = 9.0, 16.0


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
        """Those that fit too well to be excluded."""
        return tuple(x for x in self.rivals if x.state is RivalState.OPEN)

    @property
    def untested_rivals(self) -> tuple[Rival, ...]:
        """Those that could not be fitted and whose score leaves them possible."""
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
        step = replace(step, refits=promising_refits(step, base))
        steps[-1] = step
        simple = [x for x in step.refits if not is_flexible(x.causes[-1])]
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
    rivals = rivals_of(current, rest, [(x.at, x.scores) for x in steps])
    return Attribution(steps=tuple(steps), best=current, rivals=rivals)


def _look(at: Refit, effects: Sequence[Effect], seed: int) -> Step:
    variants = library_variants(at.fitted, effects)
    test = score_test(at.projector, [x.signature for x in variants], seed=seed, scale="unknown")
    scores = test.evaluate(at.fitted.residual_rows())
    return Step(at=at, variants=variants, test=test, scores=scores, refits=())


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
            if x.names[0] not in current.names and not is_flexible(x.causes[0])
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
