"""Pieces of HTML. Every text that comes from outside is escaped here."""

import re
from collections.abc import Iterable, Sequence
from html import escape

from identknee.report.tables import Table

# A number and its unit stay on one line.
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
    """Plain text as HTML, a number and its unit on one line.

    Examples
    --------
    >>> escaped("at most 2 kN")
    'at most 2&nbsp;kN'
    """
    return UNIT.sub(r"\1&nbsp;", escape(text))


def bullets(items: Iterable[str]) -> str:
    """A list of items that are HTML already; empty where there are none."""
    rows = "".join(element("li", item) for item in items)
    return element("ul", rows) if rows else ""


def disclosed(heading: str, content: str) -> str:
    """Content that one click, or Enter, shows; nothing where there is none."""
    return element("details", element("summary", escape(heading)) + content) if content else ""


def section(identity: str, heading: str, content: str, *, level: int = 2) -> str:
    """A part of the page with its heading."""
    head = element(f"h{level}", escape(heading), id=f"{identity}-heading")
    return element("section", head + content, id=identity, aria_labelledby=f"{identity}-heading")


def table_html(table: Table) -> str:
    """A table with its title, units in the heads, that scrolls by itself where it is too wide."""
    columns = range(len(table.columns))
    is_text = [i == 0 or any(isinstance(row[i], str) for row in table.rows) for i in columns]
    heads = "".join(
        element("th", escape(column.head), scope="col", class_="text" if is_text[i] else "number")
        for i, column in enumerate(table.columns)
    )
    body = "".join(element("tr", _cells(row, is_text)) for row in table.texts())
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


def _cells(row: Sequence[str], is_text: Sequence[bool]) -> str:
    first, *others = row
    cells = "".join(
        element("td", escape(cell), class_="text" if text else "number")
        for cell, text in zip(others, is_text[1:], strict=True)
    )
    return element("th", escape(first), scope="row") + cells
