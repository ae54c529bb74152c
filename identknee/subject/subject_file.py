"""The tables of a subject.toml, each value read with the place that a message about it names."""

import math
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from identknee.runs.arrays import Array
from identknee.runs.errors import InputError, suggestion
from identknee.runs.files import PathLike, check_readable

FORMAT = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """A table of a subject file.

    Attributes
    ----------
    path
        The file.
    place
        The table's name for a person, such as ``"[surfaces]"``; empty for the whole file.
    values
        What TOML gave.
    """

    path: Path
    place: str
    values: dict[str, Any]

    def check_keys(self, required: Iterable[str], optional: Iterable[str] = ()) -> None:
        """Accept the table if it has all required keys and no unknown one.

        Raises
        ------
        InputError
            Otherwise; an unknown key comes with the closest known one.
        """
        required = tuple(required)
        known = (*required, *optional)
        for key in self.values:
            if key not in known:
                self.refuse(key, f"there is no key {key!r} here", suggestion(key, known))
        for key in required:
            if key not in self.values:
                self.refuse("", f"the key {key!r} is missing", f"Add {_EXAMPLES.get(key, key)}.")

    def text(self, key: str, default: str | None = None) -> str:
        """The text at `key`, without spaces around it."""
        value = self.values.get(key, default)
        if not isinstance(value, str):
            self.refuse(key, f"{value!r} is not text", f"Write {_EXAMPLES.get(key, key)}.")
        return value.strip()

    def number(self, key: str) -> float:
        """The finite number at `key`."""
        return self._number(key, self.values[key])

    def optional_number(self, key: str) -> float | None:
        """The finite number at `key`; None where there is none."""
        return self.number(key) if key in self.values else None

    def texts(self, key: str) -> tuple[str, ...]:
        """The texts of the list at `key`; none where it is missing."""
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(x, str) for x in value):
            self.refuse(key, f"{value!r} is not a list of texts", f'Write {key} = ["...", "..."].')
        return tuple(value)

    def point(self, key: str) -> Array:
        """The three numbers at `key`, shape ``(3,)``."""
        return np.array(self._three(key, self.values[key]))

    def axes(self, key: str) -> Array:
        """The three rows of three numbers at `key`, shape ``(3, 3)``."""
        rows = self.values[key]
        if not isinstance(rows, list) or len(rows) != 3:
            self.refuse(key, "three rows are wanted", f"Write {_EXAMPLES['axes']}.")
        return np.array([self._three(key, row) for row in rows])

    def table(self, key: str, place: str | None = None) -> "Table":
        """The table at `key`."""
        value = self.values[key]
        place = place or f"[{key}]"
        if not isinstance(value, dict):
            self.refuse(key, f"{value!r} is not a table", f"Write it below a line {place}.")
        return Table(path=self.path, place=place, values=value)

    def tables(self, key: str) -> Sequence["Table"]:
        """The tables at `key`, one for each ``[[key]]`` of the file."""
        value = self.values[key]
        if not isinstance(value, list) or not all(isinstance(x, dict) for x in value):
            self.refuse(key, "a list of tables is wanted", f"Write each below a line [[{key}]].")
        if not value:
            self.refuse(key, "the list is empty", f"Add a table below a line [[{key}]].")
        return [
            Table(path=self.path, place=f"{key[:-1]} {x.get('name', i)}", values=x)
            for i, x in enumerate(value, start=1)
        ]

    def refuse(self, key: str, why: str, remedy: str) -> NoReturn:
        """Raise an `InputError` about `key` of this table, or about the table where it is empty."""
        where = ", ".join(x for x in (self.place, f"key {key}" if key else "") if x)
        raise InputError(self.path, where, why, remedy)

    def _three(self, key: str, value: Any) -> list[float]:
        if not isinstance(value, list) or len(value) != 3:
            self.refuse(
                key,
                f"three numbers are wanted, got {value!r}",
                "Write [x, y, z] with points in mm.",
            )
        return [self._number(key, x) for x in value]

    def _number(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(key, f"{value!r} is not a number", "Write a number without quotes.")
        if not math.isfinite(value):
            self.refuse(key, f"{value} is not a finite number", "Write the measured value.")
        return float(value)


def read_tables(path: PathLike) -> Table:
    """The whole of a subject file, its format checked.

    Raises
    ------
    InputError
        If it cannot be read, is no TOML or is of another format.
    """
    file = check_readable(path)
    try:
        values = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(file, "", "the text is not UTF-8", "Save the file as UTF-8.") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(
            file, "", f"this is not valid TOML: {str(error) or 'nested too deeply'}", "Mend it."
        ) from error
    table = Table(path=file, place="", values=values)
    if "format" not in values:
        table.refuse("", "the key 'format' is missing", f"Add {_EXAMPLES['format']} at the top.")
    if values["format"] is True or values["format"] != FORMAT:
        table.refuse(
            "format",
            f"format {values['format']!r} is not known",
            f"Write {_EXAMPLES['format']}, or update identknee if the file is newer.",
        )
    return table


_EXAMPLES = {
    "format": f"format = {FORMAT}",
    "name": 'name = "..." (any text)',
    "side": 'side = "right" or side = "left"',
    "description": 'description = "..."',
    "surfaces": "[surfaces] with femur, tibia_medial and tibia_lateral",
    "femur": "femur (a file under [surfaces], a frame under [frames], [x, y, z] in mm elsewhere)",
    "tibia": "tibia (a frame under [frames], [x, y, z] in mm for a ligament)",
    "tibia_medial": 'tibia_medial = "FILE.stl"',
    "tibia_lateral": 'tibia_lateral = "FILE.stl"',
    "frames": "[frames.femur] and [frames.tibia], or [landmarks] with the epicondyles",
    "origin": "origin = [x, y, z] in mm",
    "axes": "axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]] (rows: anterior, superior, right)",
    "ligaments": "a table [[ligaments]] for each ligament",
    "stiffness_kN": "stiffness_kN = ... (kN per unit strain)",
    "reference_strain_pct": "reference_strain_pct = ... (% in the scanned pose)",
}
