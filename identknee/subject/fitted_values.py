"""Parameters at which a subject was fitted, in a file beside its subject.toml."""

import json
from collections.abc import Mapping
from pathlib import Path

from identknee.runs.errors import InputError
from identknee.runs.schema import read_toml

FITTED = "fitted.toml"


def read_fitted(folder: Path) -> dict[str, float]:
    """Values by parameter name of a subject folder; empty where it was not fitted.

    Raises
    ------
    InputError
        If the file cannot be read, or a value is no finite number below the table of its owner.
    """
    file = folder / FITTED
    if not file.exists():
        return {}
    values: dict[str, float] = {}
    for owner, table in read_toml(file).items():
        for name, value in (table if isinstance(table, dict) else {"": table}).items():
            is_number = isinstance(value, float | int) and abs(value) < float("inf")
            if not name or not is_number:
                raise InputError(
                    file,
                    f"{owner}.{name}".rstrip("."),
                    "this is no finite number below the table of its owner",
                    "Write for example [ACL] and below it stiffness_kN = 9.5.",
                )
            values[f"{owner}.{name}"] = float(value)
    return values


def fitted_text(values: Mapping[str, float]) -> str:
    """The text of the file: a table for each owner, also read as ``--start``."""
    lines = [
        "# Where the fit lies: all verbs begin here. Delete this file to begin at subject.toml."
    ]
    tables: dict[str, list[str]] = {}
    for name, value in values.items():
        owner, _, quantity = name.partition(".")
        tables.setdefault(owner, []).append(f"{json.dumps(quantity)} = {float(value)!r}")
    for owner, rows in tables.items():
        lines += ["", f"[{json.dumps(owner, ensure_ascii=False)}]", *rows]
    return "\n".join(lines) + "\n"
