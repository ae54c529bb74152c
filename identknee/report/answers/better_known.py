"""Whether a trial or an error known better would tell more, in words."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from identknee.identify.nuisances import NuisanceEstimate, group_name
from identknee.laxity.trial_words import trial_words
from identknee.report.statement import Question, Statement
from identknee.report.tables import Column, Table
from identknee.runs.marginalise import SHARE
from identknee.runs.words import error_words, label_without_unit, parameter_words
from identknee.verbs.design import Design

MOST_ROWS = 12
UNITS = ("mm", "deg")


def better_known_statements(answer: Design) -> Iterator[Statement]:
    """Which stated error is best known better, and how it compares with the best trial."""
    ranking, targets = answer.choice.ranking, answer.choice.targets
    errors, trials = ([x for x in ranking if x["kind"] == y] for y in ("error", "trial"))
    if not errors:
        return
    best, trial = errors[0], trials[0]
    of = (
        f"the interval of {parameter_words(targets[0])}"
        if len(targets) == 1
        else f"the intervals of the {len(targets)} targets on average"
    )
    is_more = best["narrowing"] > trial["narrowing"]
    than = "more than any" if is_more else "less than the best"
    yield Statement(
        question=Question.NEXT,
        sentence=f"Knowing the {error_words(best['name'])} twice as well"
        f"{sizes_words(answer.nuisances, best['name'])} narrows {of} by {_percent(best)}. "
        f"That is {than} of the {len(trials)} candidate trials "
        f"(one more {_trial(answer, trial['name'])}: {_percent(trial)}).",
        tables=(_ranking(answer),),
    )


def _ranking(answer: Design) -> Table:
    """Both kinds together, the most helpful first; of several targets the one that gains most."""
    several = len(answer.choice.targets) > 1
    rows = [
        (
            _trial(answer, x["name"]) if x["kind"] == "trial" else error_words(x["name"]),
            100.0 * x["narrowing"],
            *(_most(answer, x) if several else ()),
        )
        for x in answer.choice.ranking[:MOST_ROWS]
    ]
    most = (Column(name="most of all"), Column(name="by", unit="%", decimals=1))
    columns = (
        Column(name="one more trial, or what is known twice as well"),
        Column(name="narrows by", unit="%", decimals=1),
        *(most if several else ()),
    )
    return Table(title="What would narrow the targets", columns=columns, rows=tuple(rows))


def _most(answer: Design, row: dict[str, Any]) -> tuple[str, float]:
    choice, narrowing = answer.choice, answer.choice.narrowing
    names, shares = (
        (choice.names, narrowing.by_trial)
        if row["kind"] == "trial"
        else (narrowing.errors, narrowing.by_error)
    )
    own = shares[names.index(row["name"])]
    place = int(np.argmax(own))
    return label_without_unit(choice.targets[place]), 100.0 * float(own[place])


def _trial(answer: Design, name: str) -> str:
    return trial_words(answer.candidate(answer.choice.names.index(name)))


def sizes_words(nuisances: Sequence[NuisanceEstimate], name: str) -> str:
    """How well that is, in brackets, where it is one size for each unit."""
    own = [x for x in nuisances if group_name(x.name) == name]
    sds = {unit: {x.prior_sd for x in own if x.name.endswith(f"_{unit}")} for unit in UNITS}
    told = [(min(x), unit) for unit, x in sds.items() if x]
    if not told or any(len(x) > 1 for x in sds.values()):
        return ""
    new, old = (" and ".join(f"{y * x:.3g} {unit}" for x, unit in told) for y in (SHARE, 1.0))
    return f" (to {new} instead of {old})"


def _percent(row: dict[str, Any]) -> str:
    return f"{100.0 * row['narrowing']:.2g} %"
