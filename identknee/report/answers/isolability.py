"""What a protocol could show of causes, before there are data."""

from collections.abc import Iterator, Sequence

from identknee.diagnosis.candidates import Visibility
from identknee.model.effects.facts import cause_label
from identknee.report.answers.advised import trial_table, trials_words
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.words import amount, listed
from identknee.verbs.isolability import Isolability
from identknee.verbs.trials import AdvisedTrial

MOST_CAUSES = 2
SIZES = ("detectable above", "smallest relevant effect")


def isolability_statements(answer: Isolability) -> Iterator[Statement]:
    """What a protocol could show, before there are data."""
    rows = tuple(
        (
            cause_label(name),
            *sizes_seen(x),
            listed(map(cause_label, answer.look_alikes.get(name, ()))) or "-",
        )
        for name, x in answer.effects.items()
    )
    names = ("cause", *SIZES, "looks like")
    table = Table(
        title="What these trials could show in nine of ten data sets",
        columns=tuple(Column(name=x) for x in names),
        rows=rows,
    )
    trials = f"The {answer.n_trials} trials of {answer.protocol}"
    together = "; ".join(_few(x.effects) for x in answer.groups)
    said = "would tell all causes apart."
    if answer.groups:
        said = f"could not tell all causes apart. These look alike: {together}."
    yield Statement(
        question=Question.WRONG, sentence=f"{trials} {said}", tables=(table,), is_answer=True
    )
    for group in answer.groups:
        if group.advised_trials:
            yield Statement(
                question=Question.NEXT,
                sentence=f"{_more_trials(group.advised_trials)} would help to tell "
                f"{_few(group.effects) if len(answer.groups) > 1 else 'them'} apart. The two most "
                f"alike would then be {group.distance_with_advised_trials:.1f} and not "
                f"{group.distance:.1f} units of noise apart.",
                tables=(trial_table(group.advised_trials),),
            )


def sizes_seen(x: Visibility) -> tuple[str, str]:
    """The size that nine of ten data sets would show, and the smallest that matters."""
    # Not finite in a computed answer, not a number in a loaded one.
    seen = amount(x.detectable, x.unit) if x.detectable < float("inf") else "not detectable"
    return seen, amount(x.relevant, x.unit)


def _more_trials(trials: Sequence[AdvisedTrial]) -> str:
    if len(trials) == 1:
        return f"One more trial ({trials_words(trials)})"
    return f"{len(trials)} more trials"


def _few(causes: Sequence[str]) -> str:
    """Causes in words, of many the first."""
    shown = [cause_label(x) for x in causes[:MOST_CAUSES]]
    more = len(causes) - len(shown)
    return listed([*shown, *([f"{more} more"] if more else [])])
