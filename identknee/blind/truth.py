"""The truth of a blind data set, and the sealed file that holds it."""

import base64
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from identknee.runs.declare import OF_PARAMETER, Array, declared, entry
from identknee.runs.errors import InputError
from identknee.runs.files import BYTES_PER_MB, PathLike, check_readable, write_json
from identknee.runs.schema import Number, Part, summary_of

Point = Annotated[list[Number], Field(min_length=3, max_length=3)]


class Amplitude(NamedTuple):
    """A size and its unit."""

    value: Number
    unit: str


class TruthFile(Part):
    """Schema of the sealed part of the file."""

    seed: int
    effects: list[str]
    amplitudes: dict[str, dict[str, Amplitude]]
    theta: dict[str, Number]
    signal: Number
    is_largest: bool
    lines: dict[str, tuple[Point, Point]]
    facts: dict[str, Any]
    stated_errors: dict[str, Number] = Field(default_factory=dict)


TRUTH_FILE = "truth.json"
FORMAT = 1
LARGEST_BYTES = 10**7
NOTE = "Sealed: `identknee reveal` opens it. Diagnose the data first."


@declared
class Truth:
    """The truth of a blind data set."""

    seed: int = entry("Seed that it was drawn with", unit="1")
    effects: tuple[str, ...] = entry("Names of the hidden effects; none for a null")
    amplitudes: Mapping[str, Mapping[str, tuple[float, str]]] = entry(
        "Value and unit of each effect's amplitudes by the names of the library's parameters; "
        "`amplitude` is the size that was drawn"
    )
    theta: Mapping[str, float] = entry("True ligament parameters by name", unit=OF_PARAMETER)
    signal: float = entry(
        "Root of the chi-square that the best fit of the ligament parameters leaves of the "
        "noise-free data, the generator's own knee fitted, in units of the true noise",
        unit="1",
    )
    is_largest: bool = entry(
        "Whether an effect ended at its largest plausible size short of the wanted signal"
    )
    lines: Mapping[str, tuple[Array, Array]] = entry(
        "Femoral and tibial end of each effect that is a line, in the subject's common frame",
        unit="mm",
    )
    facts: Mapping[str, object] = entry("The noise and how often the draw was repeated")
    stated_errors: Mapping[str, float] = entry(
        "Errors of the given geometry and loads as drawn [mm, deg, or relative], by the name of "
        "the nuisance that stands for each; empty where all is exact",
        default_factory=dict,
    )

    @property
    def wanted_signal(self) -> float | None:
        """The signal that was asked for; None where none was."""
        wanted = self.facts.get("wanted_signal")
        return wanted if isinstance(wanted, int | float) else None


def write_truth(truth: Truth, folder: PathLike) -> Path:
    """Write the sealed file, which nobody reads by accident, to `folder`; its path.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    text = json.dumps(summary_of(truth), allow_nan=False)
    sealed = base64.b64encode(zlib.compress(text.encode())).decode()
    return write_json(Path(folder) / TRUTH_FILE, {"format": FORMAT, "note": NOTE, "sealed": sealed})


def read_truth(folder: PathLike) -> Truth:
    """The truth that `write_truth` sealed in `folder`.

    Raises
    ------
    InputError
        If there is no such file or it cannot be opened.
    """
    path = check_readable(Path(folder) / TRUTH_FILE, LARGEST_BYTES / BYTES_PER_MB)
    try:
        outer = json.loads(path.read_text(encoding="utf-8"))
        text = zlib.decompressobj().decompress(base64.b64decode(outer["sealed"]), LARGEST_BYTES)
        values = TruthFile.model_validate_json(text)
        return Truth(
            seed=values.seed,
            effects=tuple(values.effects),
            amplitudes={
                effect: {name: (x.value, x.unit) for name, x in numbers.items()}
                for effect, numbers in values.amplitudes.items()
            },
            theta=values.theta,
            signal=values.signal,
            is_largest=values.is_largest,
            lines={name: (np.array(x), np.array(y)) for name, (x, y) in values.lines.items()},
            facts=values.facts,
            stated_errors=values.stated_errors,
        )
    except (ValueError, KeyError, TypeError, RecursionError, zlib.error) as error:
        raise InputError(
            path, "", "this is no sealed truth", "Make the case again with identknee blind."
        ) from error
