"""Pieces of HTML. Every text that comes from outside is escaped here."""

import re
from collections.abc import Iterable, Sequence
from html import escape

from identknee.report.tables import Table

# A number and its unit stay on one line.
ONE_LINE = 28  # letters of the longest cell of a column whose cells are not broken
OPTION = re.compile(r"(?<!\S)--[a-z][a-z-]*")
UNIT = re.compile(r"(\d) (?=(?:kN|N·m|N|mm|deg|%)(?![\w·]))")


def element(tag: str, content: str, **attributes: str) -> str:
    """An element with content that is HTML already; an attribute ``class_`` is its class.

    Examples
    --------
    >>> element("p", "a &lt; b", class_="note")
    '<p class="note">a &lt; b</p>'
    """
    written = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for name, value in attributes.items()
    )
    return f"<{tag}{written}>{content}</{tag}>"


def paragraph(text: str, **attributes: str) -> str:
    """A paragraph of plain text.

    Examples
    --------
    >>> paragraph("at most 2 kN")
    '<p>at most 2&nbsp;kN</p>'
    """
    return element("p", escaped(text), **attributes)


def escaped(text: str) -> str:
    """Plain text as HTML, a number and its unit on one line, as an option of a command.

    Examples
    --------
    >>> escaped("at most 2 kN")
    'at most 2&nbsp;kN'
    """
    return OPTION.sub(r'<code class="option">\g<0></code>', UNIT.sub(r"\1&nbsp;", escape(text)))


def bullets(items: Iterable[str]) -> str:
    """A list of items that are HTML already; empty where there are none."""
    rows = "".join(element("li", item) for item in items)
    return element("ul", rows) if rows else ""


def collapsible(heading: str, content: str) -> str:
    """Content that one click, or Enter, shows; nothing where there is none."""
    return element("details", element("summary", escape(heading)) + content) if content else ""


def section(identity: str, heading: str, content: str, *, level: int = 2) -> str:
    """A part of the page with its heading."""
    head = element(f"h{level}", escape(heading), id=f"{identity}-heading")
    return element("section", head + content, id=identity, aria_labelledby=f"{identity}-heading")


def table_html(table: Table) -> str:
    """A table with its title, units in the heads, that scrolls by itself where it is too wide."""
    table = table.told
    texts = table.texts()
    classes = [
        _class(
            [row[i] for row in texts], is_text=any(isinstance(row[i], str) for row in table.rows)
        )
        for i in range(len(table.columns))
    ]
    heads = "".join(
        element("th", escape(column.head), scope="col", class_="text" if i == 0 else classes[i])
        for i, column in enumerate(table.columns)
    )
    body = "".join(element("tr", _cells(row, classes)) for row in texts)
    whole = element("caption", escape(table.title))
    whole += element("thead", element("tr", heads)) + element("tbody", body)
    return scrolling(element("table", whole), table.title)


def scrolling(content: str, name: str) -> str:
    """A box around wide content that scrolls sideways, by keyboard too."""
    return element("div", content, class_="scroll", role="region", tabindex="0", aria_label=name)


def figure_html(svg: str, caption: str) -> str:
    """A figure with its caption."""
    return element(
        "figure", scrolling(svg, f"Figure: {caption}") + element("figcaption", escape(caption))
    )


def _class(cells: Sequence[str], *, is_text: bool) -> str:
    """How a column is set: numbers, words that stay on one line, or sentences."""
    if not is_text:
        return "number"
    return "text" if max(map(len, cells), default=0) <= ONE_LINE else "text long"


def _cells(row: Sequence[str], classes: Sequence[str]) -> str:
    first, *others = row
    cells = "".join(
        element("td", escape(cell), class_=name)
        for cell, name in zip(others, classes[1:], strict=True)
    )
    return element("th", escape(first), scope="row") + cells
