"""The head of the page as HTML: verdict, table, fits, next tests."""

from collections.abc import Iterable, Sequence

from identknee.report.overview.overview import Overview, Row
from identknee.report.page.markup import bullets, disclosed, element, escaped, paragraph, scrolling
from identknee.runs.findings import Finding, Severity

HEADS = ("quantity", "estimate", "95 % set", "status", "methods")
MOST_OPEN = 3
TITLE = "What is known of each parameter and force"


def overview_html(found: Overview, cautions: Sequence[Finding], level: int) -> str:
    """Verdict, warnings, table, fits, next tests; what there is nothing of is left out.

    Parameters
    ----------
    found
        From `identknee.report.overview.overview.overview`.
    cautions
        What results say against themselves, errors first. All errors stand in the open, and as
        many warnings as leave the table on the first screens.
    level
        Level of the heading above.
    """
    verdict = paragraph(found.verdict, class_=f"verdict {found.tone.value}")
    searches = paragraph(" ".join(found.searches))
    tests = element(f"h{level + 1}", "Next tests") + bullets(map(escaped, found.next_tests))
    return "".join(
        (
            verdict if found.verdict else "",
            _cautions(cautions) if cautions else "",
            _table(found.rows) if found.rows else "",
            paragraph(found.reasons, class_="note") if found.reasons else "",
            element(f"h{level + 1}", "Fits") + searches if found.searches else "",
            tests if found.next_tests else "",
        )
    )


def _cautions(found: Sequence[Finding]) -> str:
    n = max(MOST_OPEN, sum(x.severity is Severity.ERROR for x in found))
    # One more takes no more room than the words that would hide it.
    n = len(found) if len(found) == n + 1 else n
    sentences = [x.line for x in found]
    rest = sentences[n:]
    folded = disclosed(f"{len(rest)} more warnings", "".join(map(paragraph, rest)))
    return element("div", "".join(map(paragraph, sentences[:n])) + folded, class_="cautions")


def _table(rows: Iterable[Row]) -> str:
    heads = "".join(element("th", x, scope="col") for x in HEADS)
    body = "".join(map(_row, rows))
    whole = element("caption", TITLE, class_="unseen")
    whole += element("thead", element("tr", heads)) + element("tbody", body)
    return scrolling(element("table", whole, class_="overview"), TITLE)


def _row(row: Row) -> str:
    name = element("th", escaped(row.label), scope="row")
    differs = "differs" if row.found.differing else "agrees"
    cells = (
        (row.estimate, "estimate"),
        (row.limits, "limits"),
        (row.status, "status"),
        (row.agreement, differs),
    )
    return element("tr", name + "".join(element("td", escaped(x), class_=y) for x, y in cells))
