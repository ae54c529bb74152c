"""Which trials to measure next, and what they would tell."""

from collections.abc import Iterator

from identknee.identify.profile.result import Profile
from identknee.laxity.trial_words import trial_words
from identknee.report.answers.advised import table_of_trials
from identknee.report.answers.better_known import better_known_statements
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.report.words import counted, interval_words
from identknee.runs.words import capital, label, listed, parameter_words
from identknee.verbs.design import ADVICE, Design

# Beyond so many, targets are counted and not named.
MOST_NAMED = 3


def design_statements(answer: Design) -> Iterator[Statement]:
    """The trials that shrink open intervals most and by how much, then what was not offered."""
    choice = answer.choice
    name = choice.targets[0]
    before, after = choice.before[name], choice.after[name]
    targets = listed(map(parameter_words, choice.targets[:MOST_NAMED]))
    if len(choice.targets) > MOST_NAMED:
        targets = f"all {len(choice.targets)} targets"
    trials = counted(map(trial_words, answer.trials))
    yield Statement(
        question=Question.NEXT,
        sentence=f"Next test for {targets}: {trials}. "
        f"{_brings(name, before, after)} {ADVICE} lists the "
        "trials, to be filled in and appended to the data.",
        tables=(_targets(answer), _trials(answer)),
        is_answer=True,
    )
    yield from better_known_statements(answer)
    if choice.excluded:
        yield Statement(
            question=Question.NEXT,
            sentence=f"{len(choice.excluded)} of {choice.n_candidates} candidates were not "
            f"offered; for example, {choice.excluded[0].sentence}",
        )


def _brings(name: str, before: Profile, after: Profile) -> str:
    words = capital(parameter_words(name))
    now, then = (interval_words(x.lower, x.upper, before.unit) for x in (before, after))
    return f"{words} {'stays' if now == then else 'would then be'} {then}" + (
        "." if now == then else f"; it is {now} now."
    )


def _targets(answer: Design) -> Table:
    choice = answer.choice
    rows = tuple(
        (
            label(name),
            _ends(choice.before[name].lower, choice.before[name].upper),
            _ends(*choice.predicted_ends[name]),
            _ends(choice.after[name].lower, choice.after[name].upper),
        )
        for name in choice.targets
    )
    columns = tuple(Column(name=x) for x in ("target", "now", "predicted", "simulated"))
    return Table(title="Intervals of the targets", columns=columns, rows=rows)


def _trials(answer: Design) -> Table:
    return table_of_trials([(str(x["trial"]), trial_words(x)) for x in answer.trials])


def _ends(*ends: float | None) -> str:
    return " to ".join("open" if x is None else f"{x:.3g}" for x in ends)
