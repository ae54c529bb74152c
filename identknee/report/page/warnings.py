"""What results say against themselves, on the page."""

from collections.abc import Iterator

from identknee.report.page.results import Result
from identknee.report.statement import Question, Statement
from identknee.runs.findings import Severity

# Where a finding stands, by what it is about; what is not listed is about the search, or in a
# diagnosis about causes.
PLACES = {
    "data": Question.WRONG,
    "subject": Question.WRONG,
    "parameters": Question.KNOWN,
}


def warnings(result: Result) -> Iterator[Statement]:
    """The findings that a verb stored with its result; all but infos lead the page."""
    otherwise = Question.WRONG if result.verb == "diagnose" else Question.SEARCH
    for x in result.summary.get("findings") or ():
        severity = Severity(x["severity"])
        yield Statement(
            question=PLACES.get(str(x["where"]), otherwise),
            sentence=f"{severity.prefix}{x['sentence']}",
            is_warning=severity is not Severity.INFO,
        )
