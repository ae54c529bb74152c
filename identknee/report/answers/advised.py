"""Trials to add, in words and as a table."""

from collections import Counter
from collections.abc import Sequence

from identknee.report.tables import Column, Table
from identknee.report.words import trial_words
from identknee.runs.plain_records import summary_of
from identknee.runs.words import listed
from identknee.verbs.trials import AdvisedTrial


def trials_words(trials: Sequence[AdvisedTrial]) -> str:
    """Loads and flexion of each, with how often it comes."""
    counts = Counter(map(_words, trials))
    return listed(x if n == 1 else f"{x} ({n} times)" for x, n in counts.items())


def trial_table(trials: Sequence[AdvisedTrial]) -> Table:
    """A row a trial."""
    return Table(
        title="Trials to add, the most telling first",
        columns=(Column(name="trial"), Column(name="what to do")),
        rows=tuple((x.trial, _words(x)) for x in trials),
    )


def _words(trial: AdvisedTrial) -> str:
    return trial_words(summary_of(trial))
