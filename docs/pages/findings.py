"""Every kind of finding by what it is about: code, severity, meaning, and what to do about it."""

from pathlib import Path

from identknee.runs.findings import KINDS, FindingKind


def write_findings(path: Path) -> None:
    """Write a section for each thing that findings are about, with a table of their codes."""
    groups: dict[str, list[FindingKind]] = {}
    for kind in KINDS.values():
        groups.setdefault(kind.about.value, []).append(kind)
    sections = [
        "\n".join(
            [
                f"## {about}",
                "",
                "| code | severity | what was found | what to do |",
                "| --- | --- | --- | --- |",
                *map(_row, kinds),
            ]
        )
        for about, kinds in groups.items()
    ]
    path.write_text("\n\n".join(sections) + "\n", encoding="utf-8")


def _row(kind: FindingKind) -> str:
    severity = f"{kind.severity.value}, nothing holds" if kind.invalidates else kind.severity.value
    cells = (f"`{kind.code}`", severity, kind.meaning, kind.remedy)
    return f"| {' | '.join(x.replace('|', chr(92) + '|') for x in cells)} |"
