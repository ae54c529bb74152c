"""Pages that are drawn from the code and its records, so that they cannot say anything else."""

from pathlib import Path

from pages.answers import answer_reference_page
from pages.api import write_api
from pages.commands import write_commands
from pages.figures import write_figures
from pages.findings import write_findings
from pages.flow import write_flow
from pages.records import write_records
from pages.studies import write_studies


def write_pages(docs: Path) -> None:
    """Write all that the build reads beside what is written by hand; none of it is committed."""
    parts = docs / "_parts"
    parts.mkdir(exist_ok=True)
    write_api(docs / "api")
    write_commands(parts / "commands.md")
    write_findings(parts / "findings.md")
    write_figures(parts / "figures.md", docs.parent / "studies")
    write_flow(parts / "flow.html")
    write_records(parts / "records.md", docs.parent / "tests")
    (parts / "answers.md").write_text(answer_reference_page(), encoding="utf-8")
    write_studies(docs / "studies", docs.parent / "studies")
