"""Which trials of a table are asked about: all but those left out by name or by the table itself.

A trial that departs from the trend of all others over flexion is left out before anything is
fitted, in every verb alike. `keep` keeps it, `leave_out` leaves out others.
"""

import fnmatch
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identknee.checks.ambiguous_translations import translations_findings
from identknee.checks.data_noise import replicates_of
from identknee.checks.table_checks import (
    SuspiciousRow,
    suspicious_end_points,
    trial_findings,
)
from identknee.laxity.table import COORDINATES, ROTATIONS, TRANSLATIONS, Laxity
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.declare import declared, entry
from identknee.runs.errors import suggestion
from identknee.runs.findings import Finding, finding

# Equal trials that scatter so many times their noise are not equal.
MOST = 4.0
# Noise of trials of which none is stated: more than replicates of any rig have [mm, deg].
LARGE_MM, LARGE_DEG = 1.0, 2.0


def replicates_findings(laxity: Laxity, noise_mm: float | None = None) -> tuple[Finding, ...]:
    """That equal trials are further apart than their noise allows; nothing where they are not.

    Parameters
    ----------
    laxity
        The data. Trials of one state, experiment and phase are compared.
    noise_mm
        Standard deviation of lengths where one is stated beside the table.
    """
    spread = np.empty(laxity.coordinates.shape)
    spread[:, TRANSLATIONS], spread[:, ROTATIONS] = LARGE_MM, LARGE_DEG
    spread *= max(1.0, (noise_mm or 0.0) / LARGE_MM)
    if laxity.sd is not None:
        spread = np.where(np.isnan(laxity.sd), spread, laxity.sd)
    replicates = replicates_of(laxity)
    group, n_groups = replicates.group, int(replicates.group.max(initial=-1)) + 1
    squares, degrees = np.zeros(n_groups), np.zeros(n_groups)
    for column, used in enumerate(laxity.is_measured.T):
        scaled = laxity.coordinates[:, [column]] / spread[:, [column]]
        np.add.at(squares, group, replicates.deviations(scaled, used)[:, 0] ** 2)
        count = np.bincount(group[used], minlength=n_groups)
        degrees += np.maximum(count - 1, 0)
    is_apart = squares > MOST**2 * np.maximum(degrees, 1.0)
    if not is_apart.any():
        return ()
    rows = np.flatnonzero(group == int(np.argmax(squares / np.maximum(degrees, 1.0))))
    column, (one, other) = _farthest(laxity.coordinates[rows] / spread[rows])
    first, second = rows[one], rows[other]
    off = abs(float(laxity.coordinates[first, column] - laxity.coordinates[second, column]))
    unit = COORDINATES[column].rpartition("_")[2]
    names = [laxity.protocol.trials[i] for i in sorted((first, second))]
    n, total = int(is_apart.sum()), int((degrees > 0).sum())
    sentence = (
        f"Trials under equal loads differ by more than noise explains ({n} of {total} repeats): "
        f"{names[0]} and {names[1]} differ by {off:.2g} {unit}. Several states or knees in one "
        "table need a column state or tables of their own."
    )
    values = {"n_apart": n, "n_repeated": total, "first": names[0], "second": names[1]}
    return (finding("replicates-apart", "data", {**values, f"off_{unit}": off}, sentence=sentence),)


def _farthest(scaled: Array) -> tuple[int, tuple[int, int]]:
    """The column in which some of the rows are farthest apart, and which two."""
    lost = np.isnan(scaled)
    low, high = np.where(lost, np.inf, scaled), np.where(lost, -np.inf, scaled)
    column = int(np.argmax(high.max(axis=0) - low.min(axis=0)))
    return column, (int(low[:, column].argmin()), int(high[:, column].argmax()))


MOST_NAMED = 6


@declared
class TrialsAsked:
    """The trials of a table that a verb asks about, and those that were left out."""

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
    """The trials of a table that a verb asks about.

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
        If no trial is called so, one is named in both, or none is left.
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
    """Which trials are called so, shape ``(n,)``; ``*`` in a name stands for any letters.

    The name of an experiment stands for all of its trials.

    Raises
    ------
    ValueError
        If none is.
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
