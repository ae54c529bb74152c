"""Which trials to measure next, and what they would narrow."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from identknee.identify.design import ChosenTrials
from identknee.identify.optimum import NuisanceEstimate, group_name
from identknee.identify.profile.result import Profile
from identknee.laxity.trial_words import trial_description
from identknee.report.presenter import Drawing, Presenter, Question, Statement, Table, table
from identknee.runs.declare import Array
from identknee.runs.marginalise import SHARE
from identknee.runs.schema import summary_of
from identknee.runs.words import (
    capitalised,
    error_words,
    interval,
    label,
    label_without_unit,
    listed,
    parameter_words,
)
from identknee.subject.knee import Knee
from identknee.verbs.design import ADVICE, Design
from identknee.verbs.values import AdvisedTrial


def trial_list(trials: Iterable[Mapping[str, Any]]) -> str:
    """Trials to do, the beginning of a sentence."""
    return capitalised(counted(map(trial_description, trials)))


def counted(texts: Iterable[str]) -> str:
    """A list in which what comes more than once stands once, with how often.

    Examples
    --------
    >>> counted(["a", "b", "a"])
    'a (twice) and b'
    """
    counts = Counter(texts)
    return listed(x if n == 1 else f"{x} ({times(n)})" for x, n in counts.items())


def times(n: int) -> str:
    """How often, in words.

    Examples
    --------
    >>> times(1), times(2), times(3)
    ('once', 'twice', '3 times')
    """
    return {1: "once", 2: "twice"}.get(n, f"{n} times")


def interval_words(lower: float | None, upper: float | None, unit: str) -> str:
    """An interval as what a quantity is, open ends included.

    Examples
    --------
    >>> interval_words(9.5, 10.5, "kN"), interval_words(None, None, "kN")
    ('9.5 to 10.5 kN', 'open on both sides')
    """
    if lower is None and upper is None:
        return "open on both sides"
    return interval((lower, upper), unit)


def trials_words(trials: Sequence[AdvisedTrial]) -> str:
    """Loads and flexion of each, with how often it comes."""
    return counted(map(_words, trials))


def trial_table(trials: Sequence[AdvisedTrial]) -> Table:
    """The trials as a table."""
    return table_of_trials([(x.trial, _words(x)) for x in trials])


def table_of_trials(trials: Sequence[tuple[str, str]]) -> Table:
    """A row for each trial that differs, from names and words, with how often it is to be made."""
    counts = Counter(words for _, words in trials)
    first = {words: name for name, words in reversed(trials)}
    has_repeats = max(counts.values(), default=1) > 1
    return table(
        "Trials to add, the most informative first",
        ("trial", "what to do", "repeats"),
        ((first[words], words, times(n) if has_repeats else "") for words, n in counts.items()),
    )


def _words(trial: AdvisedTrial) -> str:
    return trial_description(summary_of(trial))


MOST_ROWS = 12
UNITS = ("mm", "deg")


def single_step_statements(answer: Design) -> Iterator[Statement]:
    """What one step of each kind narrows: a trial, an error known better, a cut, a force."""
    ranking, targets = answer.choice.ranking, answer.choice.targets
    best: dict[str, dict[str, Any]] = {}
    for row in ranking:
        best.setdefault(row["kind"], row)
    if len(best) < 2:
        return
    of = (
        f"the interval of {parameter_words(targets[0])}"
        if len(targets) == 1
        else f"the intervals of the {len(targets)} targets on average"
    )
    several = len(targets) > 1
    costs, has_costs = answer.choice.costs, answer.choice.has_costs
    rows = [
        (
            _step_words(answer, x),
            100.0 * x["narrowing"],
            *((costs.get(x["kind"], 1.0), 100.0 * x["per_cost"]) if has_costs else ()),
            *(_most(answer, x) if several else ()),
        )
        for x in ranking[:MOST_ROWS]
    ]
    heads = ("one more step", ("narrows by", 1, "%"))
    per_cost = (("cost", 1, ""), ("for the cost of a trial", 1, "%"))
    most = ("most of all", ("by", 1, "%"))
    order = " for its cost" if has_costs else ""
    steps = " ".join(
        f"{capitalised(_step_words(answer, x))}"
        f"{sizes_words(answer.nuisances, x['name'])}: {100.0 * x['narrowing']:.2g} %."
        for x in best.values()
    )
    final = " A cut is final: make the trials before it first." if "cut" in best else ""
    yield Statement(
        question=Question.NEXT,
        sentence=f"The best single step of each kind{order}, by how much it narrows {of}: "
        f"{steps}{final}",
        tables=(
            table(
                "Narrowing of the targets",
                (*heads, *(per_cost if has_costs else ()), *(most if several else ())),
                rows,
            ),
        ),
    )


def _step_words(answer: Design, row: Mapping[str, Any]) -> str:
    name, choice = row["name"], answer.choice
    if row["kind"] == "trial":
        return f"one more trial: {_trial(answer, name)}"
    if row["kind"] == "error":
        return f"{error_words(name)} known twice as well"
    step = next(x for x in choice.steps if x.name == name)
    trial = _trial(answer, step.trial)
    if step.kind == "cut":
        return f"{step.structure} cut, {trial}"
    what = f"{step.structure} tension" if step.kind == "force" else "contact forces"
    return f"{what}, {trial}"


def _most(answer: Design, row: dict[str, Any]) -> tuple[str, float]:
    choice, narrowing = answer.choice, answer.choice.narrowing
    names, shares = {
        "trial": (choice.names, narrowing.by_trial),
        "error": (narrowing.errors, narrowing.by_error),
    }.get(row["kind"], (tuple(x.name for x in choice.steps), narrowing.by_step))
    own = shares[names.index(row["name"])]
    place = int(np.argmax(own))
    return label_without_unit(choice.targets[place]), 100.0 * float(own[place])


def _trial(answer: Design, name: str) -> str:
    return trial_description(answer.candidate(answer.choice.names.index(name)))


def sizes_words(nuisances: Sequence[NuisanceEstimate], name: str) -> str:
    """How well that is, in brackets, where it is one size for each unit."""
    own = [x for x in nuisances if group_name(x.name) == name]
    sds = {unit: {x.prior_sd for x in own if x.name.endswith(f"_{unit}")} for unit in UNITS}
    assumed = [(min(x), unit) for unit, x in sds.items() if x]
    if not assumed or any(len(x) > 1 for x in sds.values()):
        return ""
    new, old = (" and ".join(f"{y * x:.3g} {unit}" for x, unit in assumed) for y in (SHARE, 1.0))
    return f" (to {new} instead of {old})"


# Beyond so many, targets are counted and not named.
MOST_NAMED = 3


def unbounded_words(choice: ChosenTrials) -> str:
    """Which open ends no candidate closes, as a sentence; empty where there are none."""
    ends: dict[str, list[str]] = {}
    for x in choice.unbounded:
        ends.setdefault(label_without_unit(x.target), []).append(x.end)
    named = [f"{name} {' or '.join(x)}" for name, x in ends.items()]
    if len(named) > MOST_NAMED:
        named = [*named[:MOST_NAMED], f"{len(named) - MOST_NAMED} more targets"]
    return f"No candidate bounds {listed(named, 'or')}." if named else ""


def _headline(choice: ChosenTrials) -> tuple[str, str, str]:
    """The target to speak of, and its interval now and with the trials: the first that changes."""
    found = []
    for name in choice.targets:
        now, then = (
            interval_words(x.lower, x.upper, x.unit)
            for x in (choice.before[name], choice.after[name])
        )
        found.append((name, now, then))
    return next((x for x in found if x[1] != x[2]), found[0])


def _target_table(choice: ChosenTrials) -> Table:
    return table(
        "Intervals of the targets",
        ("target", "now", "predicted", "simulated"),
        (
            (
                label(x),
                _ends(choice.before[x].lower, choice.before[x].upper),
                _ends(*choice.predicted_ends[x]),
                _ends(choice.after[x].lower, choice.after[x].upper),
            )
            for x in choice.targets
        ),
    )


def _ends(*ends: float | None) -> str:
    return " to ".join("open" if x is None else f"{x:.3g}" for x in ends)


def _both_ends(profiles: Sequence[Profile]) -> Array:
    """Both ends of each interval, shape ``(t, 2)``; NaN where open."""
    return np.array([(x.lower, x.upper) for x in profiles], dtype=np.float64)


class DesignPresenter(Presenter[Design]):
    """How advised trials are shown."""

    question = Question.NEXT

    @override
    def statements(self, answer: Design) -> Iterator[Statement]:
        """The trials that shrink open intervals most and by how much, then what was not offered."""
        choice = answer.choice
        targets = listed(map(parameter_words, choice.targets[:MOST_NAMED]))
        if len(choice.targets) > MOST_NAMED:
            targets = f"all {len(choice.targets)} targets"
        trials = counted(map(trial_description, answer.trials))
        name, now, then = _headline(choice)
        changes = f"stays {now}." if now == then else f"would then be {then}; it is {now} now."
        parts = (
            f"Next test for {targets}: {trials}.",
            f"{capitalised(parameter_words(name))} {changes}",
            unbounded_words(choice),
        )
        yield self.say(
            " ".join(filter(None, parts)),
            _target_table(choice),
            table_of_trials([(str(x["trial"]), trial_description(x)) for x in answer.trials]),
            is_answer=True,
        )
        yield self.say(f"{ADVICE} lists the trials, to be filled in and appended to the data.")
        yield from single_step_statements(answer)
        if choice.excluded:
            yield self.say(
                f"{len(choice.excluded)} of {choice.n_candidates} candidates were "
                "excluded; "
                f"for example, {choice.excluded[0].sentence}"
            )

    @override
    def drawings(self, answer: Design, subject: str, knee: Knee | None) -> Iterator[Drawing]:
        from identknee.report.design_figures import (
            candidates_figure,
            intervals_figure,
            steps_figure,
        )

        choice = answer.choice
        before, after = (list(x.values()) for x in (choice.before, choice.after))
        ends = {
            "before": _both_ends(before),
            "predicted": choice.predicted[-1],
            "achieved": _both_ends(after),
        }
        names, trials = [label(x) for x in choice.targets], listed(answer.advised)
        yield Drawing(
            name="design-intervals",
            figure=intervals_figure(names, [x.optimum_value for x in before], ends),
            caption="The interval of each target: now, as predicted with the advised trials, and "
            "as found when those trials were simulated.",
            description=f"Intervals of {listed(names)} before and after adding {trials}.",
        )
        widths = np.diff(choice.predicted)[..., 0]
        shares = np.diff(ends["achieved"])[:, 0] / widths[0]
        # An interval that is open to begin with has no width to compare with.
        closed = {x: t for t, x in enumerate(names) if np.isfinite(widths[0, t])}
        relative = {x: widths[:, t] / widths[0, t] for x, t in closed.items()}
        achieved = {x: float(shares[t]) for x, t in closed.items()}
        if closed:
            ends_at = [f"{x:.2f}" if np.isfinite(x) else "open" for x in achieved.values()]
            yield Drawing(
                name="design-steps",
                figure=steps_figure(relative, achieved),
                caption="How much narrower each interval becomes with every trial added"
                f"{', where it was closed before' * (len(closed) < len(names))}.",
                description=f"Relative widths by the number of trials added, down to "
                f"{listed(ends_at)}.",
            )
        gains = choice.losses[0] - choice.alone
        yield Drawing(
            name="design-candidates",
            figure=candidates_figure(
                answer.candidates, gains, choice.chosen, "gain of one such trial"
            ),
            caption="What each possible trial alone would gain. Circles mark the advised trials, "
            "with their order and how often each is to be made.",
            description=f"Gain of {choice.n_candidates} candidate trials; chosen are {trials}.",
        )
