"""What a result says against itself: sentences that a person must read beside the numbers."""

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from identknee.runs.declare import declared, entry
from identknee.runs.finding_kinds import KINDS, RANKS, UNCODED, FindingKind, Severity

__all__ = [
    "Finding",
    "FindingKind",
    "Severity",
    "by_severity",
    "finding",
    "finding_lines",
    "invalidating",
    "without_repeats",
]


@declared
class Finding:
    """A finding about a result.

    Terminal, ``result.json`` and report show the same findings. Checks make them with `finding`.
    """

    code: str = entry(
        "What kind of finding it is, from docs/findings.md; empty in results of earlier versions",
        default="",
    )
    severity: Severity = entry(
        "info explains; warning: conclusions may be wrong; error: the numbers must not be used "
        "before its cause is known"
    )
    sentence: str = entry("What was found and what can be done")
    where: str = entry(
        "What it is about: data, parameters, starts, subject, trials, or the name of a parameter, "
        "trial or cause"
    )
    values: Mapping[str, Any] = entry(
        "The numbers and names of the sentence by name, the last word of a name being its unit",
        default_factory=dict,
    )

    def __post_init__(self) -> None:
        if self.code and self.code not in KINDS:
            raise ValueError(f"there is no finding {self.code!r}; register it in finding_kinds")
        try:
            _ = self.detail
        except (AttributeError, IndexError, KeyError, TypeError, ValueError):
            raise ValueError(f"the values do not fill the sentence of {self.code!r}") from None

    @property
    def kind(self) -> FindingKind:
        """What all findings of this code have in common."""
        return KINDS.get(self.code, UNCODED)

    @property
    def line(self) -> str:
        """As a terminal shows it."""
        return f"{self.severity.prefix}{self.sentence}"

    @property
    def detail(self) -> str:
        """The sentence without the lead of its kind, where it was filled into a template."""
        kind = self.kind
        return kind.template.format(**self.values) if kind.template else self.sentence

    @property
    def identity(self) -> tuple[Any, ...]:
        """What two results have in common that find the same, if with other numbers."""
        if not self.code:
            return (self.severity, self.where, self.sentence)
        distinct = [self.values.get(x) for x in self.kind.distinct]
        return (self.code, self.severity, self.where, repr(distinct))


Found = TypeVar("Found", bound=Finding)


def finding(
    code: str,
    where: str,
    values: Mapping[str, Any] | None = None,
    *,
    sentence: str = "",
    severity: Severity | None = None,
) -> Finding:
    """A finding of a registered kind.

    Parameters
    ----------
    code
        Its kind.
    where
        What it is about.
    values
        Numbers and names of the sentence.
    sentence
        The sentence; left out where the kind has a template.
    severity
        How grave it is; as the kind has it where None.

    Raises
    ------
    ValueError
        If there is no such code.

    Examples
    --------
    >>> finding("no-loads", "data").line
    'Warning: No trial of the table has a load, so it contains almost no information about \
ligaments. Check that the columns of loads are there.'
    """
    kind = KINDS.get(code)
    if kind is None:
        raise ValueError(f"there is no finding {code!r}; register it in finding_kinds")
    given = {name: _plain(x) for name, x in (values or {}).items()}
    return Finding(
        code=code,
        severity=severity or kind.severity,
        sentence=sentence or kind.sentence(kind.template.format(**given)),
        where=where,
        values=given,
    )


def finding_lines(findings: Iterable[Finding]) -> list[str]:
    """What a terminal shows, the gravest first.

    Examples
    --------
    >>> about = finding("start-confirmed", "starts", sentence="The start is not the reason.")
    >>> finding_lines([about, finding("no-set-converges", "trials")])[-1]
    'The start is not the reason.'
    """
    return [x.line for x in by_severity(findings)]


def by_severity(findings: Iterable[Found]) -> list[Found]:
    """The findings by severity, then as their kinds are listed, then in their order."""
    order = list(Severity)
    return sorted(findings, key=lambda x: (-order.index(x.severity), RANKS.get(x.code, len(RANKS))))


def without_repeats(findings: Iterable[Found]) -> tuple[Found, ...]:
    """The gravest first, each thing once."""
    kept: dict[tuple[Any, ...], Found] = {}
    for x in by_severity(findings):
        kept.setdefault(x.identity, x)
    return tuple(kept.values())


def invalidating(findings: Iterable[Finding]) -> str:
    """Why nothing was computed, or nothing computed holds; empty where no finding says so."""
    return next((x.sentence for x in findings if x.kind.invalidates), "")


def _plain(value: Any) -> Any:
    """A value as JSON has it: numpy's numbers and arrays as those of Python, tuples as lists."""
    if isinstance(value, tuple | list):
        return [_plain(x) for x in value]
    return value.tolist() if hasattr(value, "tolist") else value
