"""The first sentences of results whose fit is rejected or implausible: why, and what to do next."""

import shlex
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from identknee.runs.declare import declared, entry
from identknee.runs.findings import RANKS, Doubt, Finding, Severity
from identknee.verbs.answer import Answer

NEXT = "diagnose"
# Options that the suggested command repeats, and those of them that take one value each.
GIVEN, REPEATED = ("uncertain", "noise", "plausible", "keep", "leave_out"), ("keep", "leave_out")
# Findings that come first, and the longest sentence that is not shortened there.
MOST_FINDINGS, LONGEST = 3, 240


@declared
class Opening:
    """The sentences before everything else; none at a sound fit."""

    sentences: tuple[str, ...] = entry("With their numbers, and the next command last")
    brief: tuple[str, ...] = entry("The same, each with its first finding alone")
    n_brief: int = entry("Findings that the brief ones say", unit="1")
    has_command: bool = entry("Whether the next command is among them")
    findings: tuple[Finding, ...] = entry("Findings that need not be said again")

    def without(self, findings: Iterable[Finding]) -> tuple[Finding, ...]:
        """Those of the findings that remain to be said."""
        said = {x.identity for x in self.findings}
        return tuple(x for x in findings if x.identity not in said)


def opening_of(answers: Iterable[Answer]) -> Opening:
    """Why nothing is known at the fits of these answers, the misfit first."""
    given = list(answers)
    found = {x.identity: x for answer in given for x in answer.findings if x.kind.doubt is not None}
    command = _command(given, {x.kind.doubt for x in found.values()})
    sentences, brief, said = list[str](), list[str](), list[Finding]()
    is_command_said = not command
    for doubt in Doubt:
        own = sorted(
            (x for x in found.values() if x.kind.doubt is doubt), key=lambda x: RANKS[x.code]
        )
        if not own:
            continue
        kind = own[0].kind
        leading = [x for x in own if kind.lead and x.kind.lead == kind.lead] or own[:1]
        if command and "command" in leading[0].values:
            values = {**leading[0].values, "command": command}
            leading = [replace(leading[0], sentence=kind.template.format(**values), values=values)]
            is_command_said = True
        details = [x.detail for x in leading]
        sentences.append(kind.sentence(*details) if kind.lead else leading[0].sentence)
        brief.append(kind.sentence(details[0]) if kind.lead else leading[0].sentence)
        # An error in the data is still listed after its misfit was stated.
        said += [*leading, *(x for x in own if x.severity is not Severity.ERROR)]
    n_brief = len(brief)
    if sentences and not is_command_said:
        sentences.append(f"Next: {command}")
        brief.append(sentences[-1])
    return Opening(
        sentences=tuple(sentences),
        brief=tuple(brief),
        n_brief=n_brief,
        has_command=bool(sentences and command),
        findings=tuple(said),
    )


def _command(answers: Iterable[Answer], doubts: Collection[Doubt | None]) -> str:
    """The diagnosis of the same data, then with limits of plausibility; empty where it was made."""
    records = [x.record for x in answers if x.record is not None]
    diagnosed = [x.settings for x in records if x.verb == NEXT]
    if diagnosed:
        is_limited = any(x.get("plausible") for x in diagnosed)
        if is_limited or Doubt.IMPLAUSIBLE not in doubts:
            return ""
        return command_on_data(NEXT, {**diagnosed[-1], "plausible": "default"})
    of_data = [x.settings for x in records if x.settings.get("data")]
    return command_on_data(NEXT, of_data[-1]) if of_data else f"identknee {NEXT}"


def command_on_data(verb: str, settings: Mapping[str, Any]) -> str:
    """The command that asks a verb about the same knee and data as a call with these settings."""
    data = settings["data"]
    tables = [data] if isinstance(data, str) else map(str, data)
    words = ["identknee", verb, str(settings.get("subject") or "SUBJECT"), *tables]
    for name in GIVEN:
        value = settings.get(name) or ()
        # Objects given in Python cannot be written on a command line.
        values = [x for x in ([value] if isinstance(value, str) else value) if isinstance(x, str)]
        if values and name not in REPEATED:
            values = [",".join(values)]
        for x in values:
            words += [f"--{name.replace('_', '-')}", x]
    return shlex.join(words)


def brief_line(finding: Finding) -> str:
    """A finding on a line or two: its sentence, or what its kind means if that is long.

    An error is never shortened: its details are needed to find it.
    """
    kind, is_error = finding.kind, finding.severity is Severity.ERROR
    if is_error or len(finding.sentence) <= LONGEST or not kind.code:
        return finding.line
    return f"{finding.severity.prefix}{finding.where}: {kind.meaning} {kind.remedy}".rstrip()
