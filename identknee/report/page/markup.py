"""HTML by templates, which escape every text that comes from outside."""

import re
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from identknee.report.presenter import Table

ONE_LINE = 28  # letters of the longest cell of a column whose cells are not broken
# A number and its unit stay on one line, as does an option of a command.
OPTION = re.compile(r"(?<!\S)--[a-z][a-z-]*")
NEXT = re.compile(r"(Next: )(identknee .+)")
UNIT = re.compile(r"(\d) (?=(?:kN|N·m|N|mm|deg|%)(?![\w·]))")


@cache
def environment() -> Environment:
    """The templates beside this file."""
    made = Environment(
        loader=PackageLoader("identknee.report", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )
    made.filters.update(words=words, column_classes=column_classes)
    return made


def parts() -> Any:
    """The pieces in ``parts.html``, as functions."""
    return environment().get_template("parts.html").module


def words(text: str) -> Markup:
    """Plain text as HTML, a number and its unit on one line, commands and options set as such.

    Examples
    --------
    >>> words("at most 2 kN")
    Markup('at most 2&nbsp;kN')
    >>> words("Next: identknee fit")
    Markup('Next: <code>identknee fit</code>')
    """
    if found := NEXT.fullmatch(text):
        return Markup("{}<code>{}</code>").format(*found.groups())
    whole = UNIT.sub(r"\1&nbsp;", str(Markup.escape(text)))
    return Markup(OPTION.sub(r'<code class="option">\g<0></code>', whole))


def column_classes(table: Table) -> list[str]:
    """How each column is set: as numbers, words that stay on one line, or sentences."""
    texts = table.texts()
    longest = [max((len(row[i]) for row in texts), default=0) for i in range(len(table.columns))]
    return [
        "number"
        if not any(isinstance(row[i], str) for row in table.rows)
        else ("text" if length <= ONE_LINE else "text long")
        for i, length in enumerate(longest)
    ]


def beside(*names: str) -> Iterable[Markup]:
    """Styles and programs beside this file, which are put into a page as they are."""
    folder = files("identknee.report.page")
    return (Markup((folder / x).read_text(encoding="utf-8")) for x in names)


def document(title: str, body: Markup, *, has_viewer: bool) -> str:
    """A page with its style and code; with a viewer also the library that draws it."""
    library = Markup()
    if has_viewer:
        # Loaded where it is needed: it is large.
        from plotly.offline import get_plotlyjs

        library = Markup(get_plotlyjs().replace("</script", "<\\/script"))
    style, code = beside("style.css", "page.js")
    return str(parts().document(title, body, style, code, library))
