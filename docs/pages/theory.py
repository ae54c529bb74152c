"""The way back from a function to where its equation stands."""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path

LABEL = re.compile(r"^\((theory-[\w-]+)\)=\n## (.+)$", re.MULTILINE)
ROLE = re.compile(r"\{py:(?:func|class)\}`~([\w.]+)`")
Hook = Callable[..., None]


def sections_by_name(page: Path) -> Mapping[str, list[tuple[str, str]]]:
    """Label and title of the sections of a page that name a function or class, by that name."""
    found = defaultdict(list)
    text = page.read_text(encoding="utf-8")
    heads = list(LABEL.finditer(text))
    ends = [head.start() for head in heads[1:]] + [len(text)]
    for head, end in zip(heads, ends, strict=True):
        for name in dict.fromkeys(ROLE.findall(text[head.start() : end])):
            found[name].append((head[1], head[2]))
    return found


def way_back(page: Path) -> Hook:
    """A hook of autodoc that adds links to the sections of `page` to docstrings."""
    sections = sections_by_name(page)

    def add(
        _app: object, _kind: str, name: str, _value: object, _how: object, lines: list[str]
    ) -> None:
        links = [f":ref:`{title} <{label}>`" for label, title in sections.get(name, [])]
        if links:
            lines += ["", f"*Theory:* {', '.join(links)}.", ""]

    return add
