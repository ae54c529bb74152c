"""What a result says against itself: sentences that a person must read beside the numbers."""

from collections.abc import Iterable
from enum import Enum, unique
from typing import TypeVar

from identknee.runs.declare import declared, entry


@unique
class Severity(Enum):
    """How much a finding takes from a result; the value is the word written to files."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"

    @property
    def prefix(self) -> str:
        """What stands before the sentence on a terminal; nothing before an info."""
        return _PREFIXES[self]


_PREFIXES = {Severity.INFO: "", Severity.WARNING: "Warning: ", Severity.ERROR: "Error: "}


@declared
class Finding:
    """A finding about a result.

    Terminal, ``result.json`` and report show the same findings.
    """

    severity: Severity = entry(
        "info explains; warning: conclusions may be wrong; error: the numbers must not be used "
        "before its cause is known"
    )
    sentence: str = entry("What was found and what can be done")
    where: str = entry(
        "What it is about: data, parameters, starts, subject, trials, or the name of a parameter, "
        "trial or cause"
    )

    @property
    def line(self) -> str:
        """As a terminal shows it."""
        return f"{self.severity.prefix}{self.sentence}"

    def to_json(self) -> dict[str, str]:
        """As an entry of ``findings`` in ``result.json``."""
        return {
            "severity": self.severity.value,
            "sentence": self.sentence,
            "where": self.where,
        }


Found = TypeVar("Found", bound=Finding)


def finding_lines(findings: Iterable[Finding]) -> list[str]:
    """What a terminal shows, the gravest first.

    Examples
    --------
    >>> about = Finding(severity=Severity.WARNING, sentence="Only one start.", where="starts")
    >>> finding_lines([about])
    ['Warning: Only one start.']
    """
    return [x.line for x in gravest_first(findings)]


def gravest_first(findings: Iterable[Found]) -> list[Found]:
    """The findings by their severity, in their order where it is the same."""
    order = list(Severity)
    return sorted(findings, key=lambda x: -order.index(x.severity))


def findings_summary(findings: Iterable[Finding]) -> list[dict[str, str]]:
    """What ``result.json`` has under ``findings``."""
    return [x.to_json() for x in findings]
