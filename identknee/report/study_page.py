"""How a study is drawn: its figures and the tables of its page, from its record."""

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from identknee.report.picture import png
from identknee.report.tables import Table, filled
from identknee.runs.files import prepare_folder, write_atomically

Record = dict[str, Any]


def draw_study(
    folder: Path,
    figures: Mapping[str, Callable[[Record], Figure | None]],
    tables: Callable[[Record], Mapping[str, Table | str]],
) -> None:
    """Write the figures of a study and fill its page, as the command line asks.

    The options are ``--record``, ``--out`` and ``--page``; without them the record in ``records``,
    the folder ``figures`` and ``README.md`` of the study are meant.

    Parameters
    ----------
    folder
        Of the study.
    figures
        By the name of the picture, what draws it from the record; None leaves the picture as it is.
    tables
        From the record, what stands at each mark of the page.
    """
    parser = argparse.ArgumentParser(description="Draws the figures and fills the page.")
    parser.add_argument("--record", type=Path, default=None, help="the record to read")
    parser.add_argument("--out", type=Path, default=folder / "figures", help="for the figures")
    parser.add_argument("--page", type=Path, default=folder / "README.md", help="page to fill")
    options = parser.parse_args()
    path = options.record or next((folder / "records").glob("*.json"))
    record = json.loads(path.read_text(encoding="utf-8"))
    prepare_folder(options.out)
    for name, draw in figures.items():
        figure = draw(record)
        if figure is not None:
            write_atomically(options.out / f"{name}.png", png(figure))
    page = options.page.read_text(encoding="utf-8")
    write_atomically(options.page, filled(page, tables(record)))
