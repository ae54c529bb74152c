"""How a study is drawn: its figures and the tables of its page, from its record."""

import argparse
import json
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

import identknee as ik
from identknee.report.figures import png

Record = dict[str, Any]
Cell = str | float | int | None


def draw_study(
    file: str,
    figures: Mapping[str, Callable[[Record], Figure | None]],
    tables: Callable[[Record], Mapping[str, ik.report.Table | str]],
) -> None:
    """Write the figures of a study and fill its page, as the command line asks.

    The options are ``--record``, ``--out`` and ``--page``; without them the record in ``records``,
    the folder ``figures`` and ``README.md`` of the study are meant.

    Parameters
    ----------
    file
        The script; its folder is the study's.
    figures
        By the name of the picture, what draws it from the record; None leaves the picture as it is.
    tables
        From the record, what stands at each mark of the page.
    """
    folder = Path(file).parent
    parser = argparse.ArgumentParser(description="Draws the figures and fills the page.")
    parser.add_argument("--record", type=Path, default=None, help="the record to read")
    parser.add_argument("--out", type=Path, default=folder / "figures", help="for the figures")
    parser.add_argument("--page", type=Path, default=folder / "README.md", help="page to fill")
    options = parser.parse_args()
    path = options.record or next((folder / "records").glob("*.json"))
    record = json.loads(path.read_text(encoding="utf-8"))
    ik.runs.prepare_folder(options.out)
    for name, draw in figures.items():
        figure = draw(record)
        if figure is not None:
            ik.runs.write_atomically(options.out / f"{name}.png", png(figure))
    page = options.page.read_text(encoding="utf-8")
    ik.runs.write_atomically(options.page, filled(page, tables(record)))


def filled(text: str, tables: Mapping[str, ik.report.Table | str]) -> str:
    """`text` with each table between ``<!-- NAME -->`` and ``<!-- end NAME -->`` put in anew.

    Words in place of a table are put in as they are.

    Raises
    ------
    ValueError
        If the text has no such place for a table.
    """
    for name, table in tables.items():
        place = re.compile(
            rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end {re.escape(name)} -->)", re.DOTALL
        )
        content = table if isinstance(table, str) else table.markdown()
        whole = content.replace("\\", "\\\\")
        text, count = place.subn(rf"\g<1>{whole}\n\g<2>", text)
        if count != 1:
            raise ValueError(
                f"the text has {count} places for {name!r}; mark one with <!-- {name} --> and "
                f"<!-- end {name} -->"
            )
    return text


def turn_ticks(axes: Axes, degrees: float) -> None:
    """Turn the labels below an axis so that each ends at its tick."""
    for text in axes.get_xticklabels():
        text.set(rotation=degrees, ha="right", rotation_mode="anchor")


def table(
    title: str, heads: str | Iterable[str], rows: Iterable[Iterable[Cell]]
) -> ik.report.Table:
    """A table whose columns are written as a line of heads.

    Parameters
    ----------
    title
        A line that says what it shows.
    heads
        Heads, as one text with semicolons between them or one by one: the name with its unit, and
        after ``|`` the decimals where they are not two, ``g`` for four significant digits.
    rows
        The cells.

    Examples
    --------
    >>> print(table("Knees", "knee; force [N] | 0", [("left", 12.3)]))
    Knees
    knee  force [N]
    left         12
    """
    names = heads.split("; ") if isinstance(heads, str) else heads
    columns = []
    for name, _, decimals in (x.partition(" | ") for x in names):
        places = None if decimals == "g" else int(decimals or 2)
        columns.append(ik.report.Column(name=name, decimals=places))
    return ik.report.Table(title=title, columns=tuple(columns), rows=tuple(map(tuple, rows)))
