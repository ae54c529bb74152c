"""What results say against themselves on the page, each thing once, the gravest first."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

from identknee.report.page.results import Result
from identknee.report.statement import Question, Statement
from identknee.runs.finding_kinds import About
from identknee.runs.findings import Finding, Severity, gravest_first

# Findings about these stand in the part on searches, all others in that on the model.
OF_SEARCH = (About.STARTS, About.TRIALS, About.EARLIER)


def warnings(result: Result) -> Iterator[Statement]:
    """The findings of a result; all but infos lead the page."""
    for x in result.answer.findings:
        yield Statement(
            question=Question.SEARCH if x.kind.about in OF_SEARCH else Question.WRONG,
            sentence=x.line,
            warning=None if x.severity is Severity.INFO else x,
        )


def merge_duplicate_warnings(found: Iterable[tuple[Finding, str]]) -> list[Finding]:
    """Warnings without those that another result gives too, the gravest first.

    Parameters
    ----------
    found
        Each with the result that has it. Where two results find the same, if with other numbers,
        the one with more values stays, else the first; where each has a value that the other lacks
        both stay. Findings whose kinds share a lead become one.
    """
    kept: list[tuple[Finding, str]] = []
    for finding, source in found:
        names = finding.values.keys()
        same = [
            place
            for place, (x, of) in enumerate(kept)
            if x.identity == finding.identity and of != source
            if names <= x.values.keys() or x.values.keys() <= names
        ]
        if not same:
            kept.append((finding, source))
        elif len(names) > len(kept[same[0]][0].values):
            kept[same[0]] = finding, source
    by_lead: dict[object, list[Finding]] = {}
    for place, (finding, _) in enumerate(kept):
        lead = (finding.severity, finding.kind.lead) if finding.kind.lead else place
        by_lead.setdefault(lead, []).append(finding)
    return gravest_first(_as_one(x) for x in by_lead.values())


def _as_one(findings: list[Finding]) -> Finding:
    """Findings of one lead as one, their details one after the other."""
    first, *others = findings
    if not others:
        return first
    return replace(first, sentence=first.kind.sentence(*(x.detail for x in findings)))
