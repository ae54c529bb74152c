"""All figures of the studies on one page, each with its caption and the way to its study."""

import re
from pathlib import Path

PICTURE = re.compile(r"^!\[([^\]]*)\]\((figures/[^)]+)\)\n(?:\n\*(?!\*)([^*]+)\*\n)?", re.MULTILINE)
TITLE = re.compile(r"^# (.+)$", re.MULTILINE)


def write_figures(path: Path, studies: Path) -> None:
    """Write a section for each study that has figures, from the page of the study."""
    pages = sorted(studies.glob("[0-9]*/README.md"))
    path.write_text("\n".join(filter(None, map(_section, pages))), encoding="utf-8")


def _section(page: Path) -> str:
    text, study = page.read_text(encoding="utf-8"), page.parent.name
    found = PICTURE.findall(text)
    title = TITLE.search(text)
    if not found or title is None:
        return ""
    figures = [
        f"![{said}](studies/{study}/{file})\n\n*{' '.join(caption.split()) or said}*\n"
        for said, file, caption in found
    ]
    return "\n".join([f"## [{title[1]}](studies/{study}/README.md)\n", *figures])
