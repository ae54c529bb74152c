"""What every answer carries beside its numbers: what speaks against it, and how it was made."""

from identknee.runs.declare import declared, entry
from identknee.runs.findings import Finding
from identknee.runs.record import Record


@declared
class Answer:
    """The result of a verb."""

    seconds: float = entry("Time taken, without loading and compiling", unit="s", default=0.0)
    assumptions: tuple[str, ...] = entry("What was taken for granted, as sentences", default=())
    findings: tuple[Finding, ...] = entry("What speaks against the result", default=())
    record: Record | None = entry(
        "The call, its inputs, seed, versions and time; only what a verb gave back has one",
        default=None,
    )

    @property
    def failure(self) -> str:
        """Why nothing could be computed; empty where something was."""
        return ""
