"""The causes that explain a misfit, tried one by one, and the verdict on them with its reasons."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import partial, reduce
from math import comb, log

import numpy as np
from scipy.special import ndtri

from identknee.calibrate.bounded_least_squares import ConstrainedFit
from identknee.diagnosis.candidates import CandidateCauses, Variant, library_candidates
from identknee.diagnosis.fitting import (
    Refit,
    Rival,
    RivalState,
    could_matter,
    is_undecided,
    posterior_of,
    refit,
    refit_of,
    refit_via_low_loads,
    rivals_of,
)
from identknee.diagnosis.misfit import log_weighted_tail
from identknee.diagnosis.missing_line import LineEnds
from identknee.diagnosis.score import LEVEL, CandidateScore, Scores
from identknee.identify.laplace import Interval, Laplace
from identknee.model.effects.effect import Effect
from identknee.model.effects.facts import cause_label, facts_of
from identknee.model.effects.loads import LoadError
from identknee.model.effects.structures import MissingStructure, Structure
from identknee.model.effects.tissues import direction_words
from identknee.runs.declare import Array, declared, derived, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.progress import counted, progress, progress_bar, stage
from identknee.runs.record import Outcome
from identknee.runs.words import PLAIN, unit_of

MOST_CAUSES = 3
# Log evidence that a first cause must gain, and that a larger set must gain over a smaller one.
LEAST_GAIN, FURTHER_GAIN = 2.0, 5.0
# Fall of the chi-square that the largest score of a library may reach by chance.
LEAST_FALL, FURTHER_FALL = 9.0, 16.0
# Single causes that are swapped into a set which is about to win, and refitted alone from there.
MOST_SWAPPED, MOST_ALONE = 4, 2
# Steps of the search: it may return to smaller sets, but must end.
MOST_LOOKS = 6
# More causes than these probably stand in for one that no library lists.
MOST_NAMED = 2
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
# Smaller shares, tried in turn where a refit from that amplitude has no prediction.
LESS = (0.03, 0.01, 0.001)
# Seconds that it takes to finish the refit of a simple effect, and of one with many amplitudes
# that the linear model predicts to fit better by more than NEARLY_DONE.
SIMPLE, FAR_FROM_DONE, NEARLY_DONE = 0.14, 4.0, 1.0
# The best other refits from whose ligaments one begins that failed.
MOST_HELPERS = 2


@declared
class AttributionStep(CandidateCauses):
    """The scores at one fit, and the refits they suggest."""

    at: Refit = entry("The fit")
    scores: Scores = entry("How strongly it favours each effect that is not in it")
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
    base: Refit,
    effects: Sequence[Effect],
    *,
    seed: int,
    is_forced: bool = False,
    executor: Executor = serial,
) -> Attribution:
    """The explanation of what a fit leaves, by a search of sets of causes.

    At each step the effects that score highest join the best set in turn. Before a larger set wins,
    smaller ones are refitted from where it ended: with each of its causes left out or swapped, and
    single causes alone. The search ends when no further effect scores higher than
    chance allows, when no larger set is worth its causes, or at three.

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
    executor
        Who refits causes.
    """
    sets, steps = _Sets(base, len(effects)), [score_candidates(base, effects, seed)]
    while len(sets.best.causes) < MOST_CAUSES and len(steps) < MOST_LOOKS:
        step, current = steps[-1], sets.best
        if not (step.is_significant or (is_forced and not current.causes)):
            break
        step = replace(step, refits=refit_top_candidates(step, base, executor))
        steps[-1] = step
        sets.add(step.refits)
        sets.look_back(steps[0].refits)
        left = [x for x in effects if x.name not in sets.best.names]
        if not left or any(x.at is sets.best for x in steps):
            break
        steps.append(score_candidates(sets.best, left, seed))
    sets.let_flexible_win(steps[0].refits)
    best = sets.best
    left = [x for x in effects if x.name not in best.names]
    if left and steps[-1].at is not best:
        steps.append(score_candidates(best, left, seed))
    rivals = rivals_of(best, sets.others, [(x.at, x.scores) for x in steps])
    return Attribution(steps=tuple(steps), best=best, rivals=rivals)


def score_candidates(at: Refit, effects: Sequence[Effect], seed: int) -> AttributionStep:
    """The scores of effects at a fit, before any refit."""
    with stage("scoring causes"):
        found = library_candidates(at.fitted, effects, seed=seed)
        scores = found.test.evaluate(at.fitted.scored_rows)
    return AttributionStep(
        at=at, variants=found.variants, test=found.test, scores=scores, refits=()
    )


class _Sets:
    """The sets of causes refitted so far, each with its best fit, and the set that wins.

    Parameters
    ----------
    base
        The fit without causes.
    n_effects
        How many candidates there are: of a larger size there are more sets, one of which wins by
        chance.
    """

    def __init__(self, base: Refit, n_effects: int) -> None:
        self._base, self._n_effects = base, n_effects
        self._found: dict[frozenset[str], Refit] = {}
        self._seen: set[frozenset[str]] = set()
        self.best = base

    def add(self, refits: Sequence[Refit]) -> None:
        """Keep refits, each set with that of the highest evidence, and let the best one win."""
        for x in refits:
            key = frozenset(x.names)
            if key not in self._found or x.log_evidence > self._found[key].log_evidence:
                self._found[key] = x
        self.best = self._base
        for size in range(1, MOST_CAUSES + 1):
            own = [
                x
                for x in self._found.values()
                if len(x.causes) == size and not any(map(is_flexible, x.causes))
            ]
            top = max(own, key=lambda x: x.log_evidence, default=self._base)
            if is_better(top, self.best, self._n_effects):
                self.best = top

    def look_back(self, singles: Sequence[Refit]) -> None:
        """Refit what is simpler than the winner, or as simple, from where that ended.

        Parameters
        ----------
        singles
            Refits of single causes, the highest evidence first.
        """
        while len(self.best.causes) > 1 and frozenset(self.best.names) not in self._seen:
            winner = self.best
            self._seen.add(frozenset(winner.names))
            others = [x for x in singles if not is_flexible(x.causes[0])]
            others = [x for x in others if x.names[0] not in winner.names][:MOST_SWAPPED]
            # Of a pair, each is alone when the other is left out.
            own = [x for x in singles if x.names[0] in winner.names and len(winner.causes) > 2]
            found = [_alone(self._base, winner, x) for x in own + others[:MOST_ALONE]]
            for name in winner.names:
                found.append(_without(self._base, winner, name))
                found += [_without(self._base, winner, name, x) for x in others]
            self.add(found)

    def let_flexible_win(self, singles: Sequence[Refit]) -> None:
        """Let effects that fit almost anything win, but only in the end and by evidence."""
        flexible = [x for x in singles if is_flexible(x.causes[-1])]
        best = max([self.best, *flexible], key=lambda x: x.log_evidence)
        if best is not self.best and is_better(best, self._base, self._n_effects):
            self.best = best

    @property
    def others(self) -> tuple[Refit, ...]:
        """The sets that are no larger than the winner: others are not worth their causes."""
        most = max(len(self.best.causes), 1)
        found = (x for x in self._found.values() if len(x.causes) <= most)
        return tuple(x for x in found if x is not self.best and x.causes)


def is_better(new: Refit, old: Refit, n_effects: int) -> bool:
    """Whether `new` is worth its causes: the data must say so, and the prior not forbid it.

    A set of several causes must win by a factor of e^5 over a smaller one, after the number of sets
    of either size is paid for.
    """
    fall = old.misfit_chi2 - new.misfit_chi2
    size, smaller = len(new.causes), len(old.causes)
    if size < 2:
        return fall > LEAST_FALL and new.log_evidence > old.log_evidence + LEAST_GAIN
    paid = log(comb(n_effects, size) / comb(n_effects, smaller))
    return fall > FURTHER_FALL and new.log_evidence > old.log_evidence + FURTHER_GAIN + paid


def _alone(base: Refit, current: Refit, single: Refit) -> Refit:
    """A single cause, refitted from where a larger set ended."""
    (cause,) = single.causes
    at = current if cause.name in current.names else single
    theta = current.fitted.theta[: base.n_base]
    return refit(base, [cause], [np.r_[theta, at.amplitudes(cause.name)]], beside=[single])


def _without(base: Refit, current: Refit, name: str, *instead: Refit) -> Refit:
    """A set without one of its causes, or with those of other refits instead, refitted."""
    kept = [x for x in current.causes if x.name != name]
    theta = np.delete(current.fitted.theta, list(current.places(name)))
    start = np.concatenate([theta, *(x.amplitudes(x.names[0]) for x in instead)])
    return refit(base, [*kept, *(y for x in instead for y in x.causes)], [start])


def refit_top_candidates(
    step: AttributionStep, base: Refit, executor: Executor = serial
) -> tuple[Refit, ...]:
    """The effects that score high, refitted: all for a few steps, the better ones to the end.

    One that has no prediction, or is stuck where a trial leaves its branch, begins again with less
    of the effect and from the ligaments of refits that succeeded, before it is given up.

    Returns
    -------
    tuple of Refit
        The highest evidence first.
    """
    tasks = [_Task.of(step, x, base) for x in _high_scoring(step)]
    first = executor.map(partial(_begun, base), tasks)
    begun = [
        refit_of(base, task.causes, x)
        for task, x in zip(
            tasks, progress(first, total=len(tasks), description="trying causes"), strict=True
        )
    ]
    best = max((x.log_evidence for x in begun), default=0.0)
    costs = [task.cost(x) for task, x in zip(tasks, begun, strict=True)]
    is_finished = [
        place < ALWAYS or x.log_evidence > best - FAR_BEHIND for place, x in enumerate(begun)
    ]
    with progress_bar("fitting causes", len(costs), costs=costs) as advance:
        asked = [
            (task, x.fitted.constrained if is_wanted else None)
            for task, x, is_wanted in zip(tasks, begun, is_finished, strict=True)
        ]
        ends = counted(executor.map(partial(_finished, base), asked), advance)
        found = [
            x if end is None else refit_of(base, x.causes, end)
            for x, end in zip(begun, ends, strict=True)
        ]
    best = max((x.log_evidence for x in found), default=0.0)
    for place, task in enumerate(tasks):
        if task.is_possible and is_undecided(found[place], best - found[place].log_evidence):
            found[place] = task.rescued(base, found, place, is_finished=is_finished[place])
    return tuple(sorted(found, key=lambda x: -x.log_evidence))


# Run by workers, which return only the fit: the caller has the model already.
def _begun(base: Refit, task: "_Task") -> ConstrainedFit:
    return task.begun(base).fitted.constrained


def _finished(base: Refit, asked: tuple["_Task", ConstrainedFit | None]) -> ConstrainedFit | None:
    task, begun = asked
    if begun is None:
        return None
    return task.finished(base, refit_of(base, task.causes, begun)).fitted.constrained


def is_flexible(effect: Effect) -> bool:
    """Whether an effect has so many amplitudes that it can imitate most others."""
    return effect.parameters.n > MOST_AMPLITUDES


def _high_scoring(step: AttributionStep) -> list[CandidateScore]:
    found_high = [x for x in step.scores.candidates if x.score > LEAST_SCORE]
    if step.at.causes:
        by_name = {x.effect.name: x.effect for x in step.variants}
        found_high = [x for x in found_high if not is_flexible(by_name[x.name])]
    unseen = {x.effect.name for x in step.variants if x.is_secant and not step.at.causes}
    return found_high[:MOST_REFITS] + [x for x in found_high[MOST_REFITS:] if x.name in unseen]


@declared
class _Task:
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
        is_far = is_flexible(self.causes[-1]) and begun.predicted_reduction > NEARLY_DONE
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
            found = refit(base, self.causes, [begun.fitted.theta, *starts], known=[begun])
        else:
            # With few amplitudes there are few minima, so the lowest after a few steps ends lowest.
            tried = [begun]
            for x in starts:
                tried.append(refit(base, self.causes, [x], most_steps=FEW_STEPS, beside=tried))
            found = min(tried, key=lambda x: x.fitted.deviance)
            if found.fitted.outcome is not Outcome.MINIMUM:
                found = refit(base, self.causes, [found.fitted.theta], known=[found])
        if found.fitted.outcome is Outcome.MINIMUM:
            return found
        return max(
            found, refit_via_low_loads(base, found, starts[-1]), key=lambda x: x.log_evidence
        )

    def rescued(
        self, base: Refit, all_found: Sequence[Refit], place: int, *, is_finished: bool
    ) -> Refit:
        """A refit that failed, is stuck or was left, begun again also where others succeeded.

        One that was taken to its end is continued; from its starts it would end there again.
        """
        found = all_found[place]
        helpers = [x for x in all_found if x is not found and x.fitted.evaluation.is_finite]
        helpers = sorted(helpers, key=lambda x: -x.log_evidence)[:MOST_HELPERS]
        sizes = [self.values]
        if found.fitted.evaluation.is_finite:
            sizes.append(found.fitted.theta[-len(self.values) :])
        n_base, n = base.n_base, len(self.starts[0]) - len(self.values)
        others = self.starts[1][n_base:n]
        tried = [
            refit(base, self.causes, [found.fitted.theta], known=[found])
            if is_finished
            else self.finished(base, found)
        ]
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
    # The fitted parameters had compensated for the effect; move them back.
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
    part = np.array(variant.values)
    part[variant.moved] += share * (values - variant.values)[variant.moved]
    return part


# A model whose misfit is less probable than FITS is doubted, than HARDLY_FITS rejected.
FITS, HARDLY_FITS = 0.01, 0.001
# Insertions less probable than this may be those of another structure.
FAR_OFF = 0.1
# Share of the prior variance of a shift: data that remove less do not inform it.
LEAST_MOVED = 1e-6
# Multiples of a stated noise that are tried as explanations of a misfit.
MULTIPLES = (1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
# A verdict that changes at one of these multiples of a stated noise is NOT_TESTABLE.
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
        # Reasons to reject the best explanation.
        names = " and ".join(map(cause_label, best.names))
        faults = []
        if fits <= HARDLY_FITS:
            faults.append(f"With {names} the misfit is still improbable ({_p_words(fits)}).")
        if len(best.causes) > MOST_NAMED:
            faults.append(
                f"No two known causes explain it. Together {names} would, but so many may stand in "
                "for something that the library does not list: see the missing wrench."
            )
        faults += [
            f"The {cause_label(name)} would need an amplitude at the limit of its plausible range."
            for name in best.names
            if best.is_at_range_end(name)
        ]
    if faults:
        reasons = [f"{reasons[0]}{_noise_explaining_misfit(attribution)}", *faults, *untested]
        sentence = UNTESTED if untested else Verdict.UNEXPLAINED.sentence
        return _conclusion(Verdict.UNEXPLAINED, p_value, best, (), reasons, sentence)
    doubts = _reservations(attribution, fits)
    # All causes of the best explanation and of the rivals still open.
    rivals = [x.refit for x in attribution.open_rivals]
    group = tuple(dict.fromkeys(name for x in (best, *rivals) for name in x.names))
    is_alone = len(group) == len(best.causes)
    if is_alone and not doubts and not untested:
        return _conclusion(Verdict.NAMED, p_value, best, group, reasons)
    reasons += [*(reason for _, reason in doubts), *untested]
    short = [x for x, _ in doubts] + ["another cause could not be tested"] * bool(untested)
    n = len(best.causes)
    fits_words = "one known cause fits" if n == 1 else f"{n} known causes together fit"
    alone = f"The model gets something wrong, and {fits_words}, with a doubt: {'; '.join(short)}."
    sentence = alone if is_alone else SEVERAL
    return _conclusion(Verdict.AMBIGUOUS, p_value, best, group, reasons, sentence)


def _p_words(p_value: float) -> str:
    return "p < 0.001" if p_value < 0.001 else f"p = {p_value:.2g}"


def _depends_on_noise(attribution: Attribution, p_value: float) -> bool:
    """Whether the verdict would change if stated noise were wrong by a quarter or a third."""
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
    factor = next((x for x in MULTIPLES if base.alarm_p_value(score, x) > LEVEL), None)
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


def _reservations(attribution: Attribution, fits: float) -> list[tuple[str, str]]:
    """Why the best explanation may not be the right one or not all: in a few words, and whole."""
    best = attribution.best
    doubts = [
        (
            f"the {cause_label(x.name)} would lie far from its anatomical site",
            (
                f"The insertions of the {cause_label(x.name)} would lie "
                f"{shift_mm(best, x):.0f} mm from their anatomical sites, which is rare "
                f"({_p_words(p_value)}): a structure that no library lists may lie there."
            ),
        )
        for x in best.causes
        if isinstance(x, Structure) and (p_value := site_p_value(best, x)) <= FAR_OFF
    ]
    if fits <= FITS:
        reason = f"The remaining misfit is rather improbable ({_p_words(fits)})."
        doubts.append(("its residuals exceed the noise", reason))
    if (pattern := best.pattern_p_value) <= LEVEL:
        reason = (
            "What it leaves is smooth in flexion and load, or a wrench in every trial "
            f"({_p_words(pattern)}): the cause may be one that the library does not list."
        )
        doubts.append(("what it leaves has a pattern", reason))
    if len(best.causes) > 1 and all(map(_is_constant_load, best.causes)):
        reason = (
            "Both are loads that act in every trial: together they may stand in for another such "
            "load that the library does not list."
        )
        doubts.append(("two constant loads may stand in for another", reason))
    if attribution.has_remaining_misfit:
        further = cause_label(attribution.steps[-1].scores.candidates[0].name)
        reason = f"Significant misfit remains: the {further} scores high but does not fit."
        doubts.append(("significant misfit remains", reason))
    return doubts


def _is_constant_load(effect: Effect) -> bool:
    return isinstance(effect, LoadError) and effect.is_on_unloaded_knee


def site_p_value(refit: Refit, structure: Structure) -> float:
    """Probability that the insertions of a structure are found so far from their anatomical sites.

    The shifts found are compared with what their prior, and how much of it the data can move, lead
    one to expect: of a shift with prior variance 1 and posterior variance c, the value found has
    the variance 1 - c. 1 for a structure whose insertions are fixed or that pulls at nothing.
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
        moved = direction_words({name: x.value for name, x in self.parameters.items()})
        return moved or (known.sentence if (known := facts_of(self.name)) else OF_THE_CALLER)

    @property
    @derived("Where its plausible size comes from")
    def source(self) -> str:
        return known.source if (known := facts_of(self.name)) else OF_THE_CALLER


def causes_of(refit: Refit) -> tuple[Cause, ...]:
    """The causes that a fit has beyond the base model, with their amplitudes.

    For amplitudes in one unit that may have either sign, such as the components of a force, the
    total counts: the root of the sum of their squares, less what their errors add to it. Of others
    in the unit of the first, such as the stiffnesses of two halves, the largest counts.
    """
    posterior, covariance = posterior_of(refit.fitted), refit.covariance()
    return tuple(_cause(refit, x, posterior, covariance) for x in refit.names)


def ligament_estimates(refit: Refit) -> dict[str, dict[str, Estimate]]:
    """The calibrated parameters of a fit by ligament and quantity."""
    posterior = posterior_of(refit.fitted)
    n = refit.fitted.model.n_ligament_parameters
    tree: dict[str, dict[str, Estimate]] = {}
    for i, name in enumerate(refit.fitted.model.parameters.names[:n]):
        found = _estimate(name, i, posterior)
        tree.setdefault(name.rpartition(".")[0], {})[found.name] = found
    return tree


def made_by_priors(refit: Refit) -> tuple[str, ...]:
    """The ligaments' parameters whose interval priors make more than the data."""
    model = refit.fitted.model
    own = posterior_of(refit.fitted).made_by_priors()[: model.n_ligament_parameters]
    return tuple(model.parameters.names[i] for i in np.flatnonzero(own))


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
    knee = refit.fitted.model.knee
    effect = next(x for x in refit.causes if x.name == name)
    line = None
    if isinstance(effect, MissingStructure) and len(effect.femoral) == 1:
        femoral, tibial = effect.insertions(refit.amplitudes(name))
        ends = np.vstack([knee.femur_frame.to_common(femoral), knee.tibia_frame.to_common(tibial)])
        line = LineEnds.of(ends, knee)
    return Cause(
        name=name,
        amplitude=amplitude.value,
        unit=amplitude.unit,
        ci95=amplitude.ci95,
        parameter=amplitude.name,
        parameters={x.name: x for x in found},
        line=line,
    )


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
        unit=unit_of(name) or PLAIN,
        ci95=posterior.interval(i),
    )
