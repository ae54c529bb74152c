"""The trials of a table that are used: all but those left out by name or by the table itself.

Every verb leaves out trials that depart from the trend of the others over flexion, before anything
is fitted. `keep` keeps such a trial, `leave_out` leaves out others.
"""

import fnmatch
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.checks.ambiguous_translations import translations_findings
from identknee.checks.data_noise import replicates_findings
from identknee.checks.table_checks import (
    SuspiciousRow,
    suspicious_end_points,
    trial_findings,
)
from identknee.laxity.table import Laxity
from identknee.runs.declare import BoolArray, declared, entry
from identknee.runs.errors import suggestion
from identknee.runs.findings import Finding, finding

MOST_NAMED = 6


@declared
class TrialsAsked:
    """The trials of a table that a verb uses, and those that were left out."""

    given: Laxity = entry("The data as they were given")
    laxity: Laxity = entry("The data, cells of trials left out blank")
    by_name: tuple[str, ...] = entry("Trials left out because they were named")
    contradicted: tuple[str, ...] = entry("Trials left out because the table contradicts them")
    findings: tuple[Finding, ...] = entry("Both as findings, and those of reading the data")

    @property
    def with_contradicted(self) -> Laxity:
        """The data with the trials that the table contradicts."""
        return self.given.without(np.isin(self.given.protocol.trials, self.by_name))


def trials_asked(
    laxity: Laxity,
    *,
    keep: Sequence[str] = (),
    leave_out: Sequence[str] = (),
    noise_mm: float | None = None,
) -> TrialsAsked:
    """The trials of a table that a verb uses.

    Parameters
    ----------
    laxity
        The data.
    keep
        Names of trials to keep although the table contradicts them; ``*`` stands for any letters.
    leave_out
        Names of trials to leave out.
    noise_mm
        Standard deviation of lengths where one is stated beside the table.

    Raises
    ------
    ValueError
        If a name fits no trial, a trial is named in both `keep` and `leave_out`, or none is left.
    """
    trials = laxity.protocol.trials
    is_kept = named_trials(laxity, keep, "--keep")
    is_named = named_trials(laxity, leave_out, "--leave-out")
    if (is_both := is_kept & is_named).any():
        name = trials[int(np.flatnonzero(is_both)[0])]
        raise ValueError(f"{name} is named in --keep and in --leave-out; name it in one of them")
    without = laxity.without(is_named)
    rows = [x for x in _off_their_course(without) if not is_kept[x.trial]]
    is_off = np.isin(np.arange(laxity.n), [x.trial for x in rows])
    left = without.without(is_off)
    if laxity.is_measured.any() and not left.is_measured.any():
        raise ValueError("--leave-out leaves no measured trial; leave out fewer")
    return TrialsAsked(
        given=laxity,
        laxity=left,
        by_name=tuple(np.array(trials, object)[is_named]),
        contradicted=tuple(np.array(trials, object)[is_off]),
        findings=(
            *laxity.findings,
            *translations_findings(left, noise_mm),
            *replicates_findings(without, noise_mm),
            *trial_findings(rows, without, "trial-against-course", is_left_out=True),
            *(
                finding("trial-left-out", trials[i], {"trial": trials[i]})
                for i in np.flatnonzero(is_named)
            ),
        ),
    )


def _off_their_course(laxity: Laxity) -> list[SuspiciousRow]:
    """Trials that contradict the others of their experiment and state."""
    series = laxity.protocol.series
    if not series.any():
        return suspicious_end_points(laxity)
    found = []
    for one in np.unique(series):
        places = np.flatnonzero(series == one)
        own = suspicious_end_points(laxity.select(places))
        found += [replace(x, trial=int(places[x.trial])) for x in own]
    return found


def named_trials(laxity: Laxity, names: Sequence[str], flag: str) -> BoolArray:
    """Which trials have one of the names, shape ``(n,)``; ``*`` stands for any letters.

    The name of an experiment stands for all of its trials.

    Raises
    ------
    ValueError
        If a name fits no trial.
    """
    trials = laxity.protocol.trials
    found = np.zeros(laxity.n, bool)
    for name in names:
        own = np.array([fnmatch.fnmatchcase(x, name) for x in trials], bool)
        if laxity.protocol.experiment is not None:
            own |= np.array(laxity.protocol.experiment) == name
        if not own.any():
            raise ValueError(
                f"{flag} {name}: there is no such trial. "
                f"{suggestion(name, trials, most=MOST_NAMED)}"
            )
        found |= own
    return found
