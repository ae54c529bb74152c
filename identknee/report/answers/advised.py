"""Trials to add, in words and as a table."""

from collections import Counter
from collections.abc import Sequence

from identknee.laxity.trial_words import trial_words
from identknee.report.tables import Column, Table
from identknee.report.words import counted, times
from identknee.runs.plain_records import summary_of
from identknee.verbs.trials import AdvisedTrial


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
    return Table(
        title="Trials to add, the most telling first",
        columns=(Column(name="trial"), Column(name="what to do"), Column(name="repeats")),
        rows=tuple(
            (first[words], words, times(n) if has_repeats else "") for words, n in counts.items()
        ),
    )


def _words(trial: AdvisedTrial) -> str:
    return trial_words(summary_of(trial))
