"""What the results of one subject say on the page, each thing once, with where it is from."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from identknee.report.answers.taken import taken_for_granted
from identknee.report.overview.searches import is_beaten
from identknee.report.page.computed_part import short_path
from identknee.report.page.fits_part import fits_statement
from identknee.report.page.results import Result
from identknee.report.page.warnings import warnings
from identknee.report.presenter import of_type, statements_of
from identknee.report.statement import Question, Statement
from identknee.runs.outcome import Outcome
from identknee.runs.words import capital, listed
from identknee.verbs.fit import Calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """A finding with where it is from."""

    finding: Statement
    source: str


def all_said(results: Sequence[Result]) -> list[Said]:
    """What results say: fits of one table side by side, what several take for granted once."""
    fits = of_type([x.answer for x in results], Calibration)
    together = _together(results)
    said = []
    for result in results:
        own = [*_warnings(result, fits), *statements_of(result.answer)]
        if result in together:
            # What leads each of these stands in the table of all.
            own = [x for x in own if not x.is_answer]
            if result is together[0]:
                own.insert(0, fits_statement([x.answer for x in together]))
        said += [Said(finding=x, source=_source(result)) for x in own]
    return [*said, *_taken(results)]


def _together(results: Sequence[Result]) -> list[Result]:
    """The fits of the table that most were made to, where there are several."""
    found = [
        x
        for x in results
        if any(y.outcome is not Outcome.START_FAILED for y in of_type([x.answer], Calibration))
    ]
    counts = Counter(x.data_digest for x in found)
    main, n = counts.most_common(1)[0] if counts else ("", 0)
    return [x for x in found if x.data_digest == main] if n > 1 else []


def _warnings(result: Result, fits: Sequence[Calibration]) -> Iterator[Statement]:
    """What a result says against itself; of a fit that another beats, none leads the page."""
    is_past = any(is_beaten(x, fits) for x in of_type([result.answer], Calibration))
    for x in warnings(result):
        yield replace(x, question=Question.SEARCH, warning=None) if is_past else x


def _taken(results: Sequence[Result]) -> Iterator[Said]:
    """The assumptions of results, with their source if not shared by all."""
    taken = {_source(x): taken_for_granted(x.answer) for x in results}
    sources = [x for x in taken if taken[x]]
    by_sources: dict[tuple[str, ...], list[str]] = {}
    for sentence in dict.fromkeys(x for source in sources for x in taken[source]):
        own = tuple(x for x in sources if sentence in taken[x])
        by_sources.setdefault(own, []).append(sentence)
    for own, sentences in by_sources.items():
        told = " ".join(sentences)
        if len(own) < len(sources):
            told = f"{capital(listed(own))}: {told}"
        yield Said(finding=Statement(question=Question.KNOWN, sentence=told), source=listed(own))


def _source(result: Result) -> str:
    return f"{result.verb} of {short_path(result.data)}" if result.data else result.verb
