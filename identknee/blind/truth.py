"""What is behind a blind data set, and the sealed file it is kept in."""

import base64
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from identknee.blind.truth_schema import TruthFile
from identknee.runs.arrays import Array
from identknee.runs.errors import InputError
from identknee.runs.files import BYTES_PER_MB, PathLike, check_readable, plain, write_json

TRUTH_FILE = "truth.json"
FORMAT = 1
LARGEST_BYTES = 10**7
NOTE = "Sealed: `identknee reveal` opens it. Diagnose the data first."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What is behind a blind data set.

    Attributes
    ----------
    seed
        That it was drawn with.
    effects
        Names of the hidden effects; none for a null.
    amplitudes
        Of each effect: value and unit by the name of the library's parameter; ``"amplitude"`` is
        the one that it was sized by.
    theta
        True stiffness [kN] and reference strain [%] by the name of the parameter.
    signal
        Root of the chi-square that the best fit of the ligament parameters leaves of the noise-free
        data, the generator's own knee fitted, in units of the true noise.
    is_largest
        Whether an effect ended at its largest plausible size short of the wanted signal.
    lines
        Femoral and tibial end of each effect that is a line, in the subject's common frame [mm].
    facts
        The noise and how often the draw was repeated.
    stated_errors
        How wrong what is given was drawn [mm, deg, or relative], by the name of the nuisance that
        stands for it; empty where it is exact.
    """

    seed: int
    effects: tuple[str, ...]
    amplitudes: Mapping[str, Mapping[str, tuple[float, str]]]
    theta: Mapping[str, float]
    signal: float
    is_largest: bool
    lines: Mapping[str, tuple[Array, Array]]
    facts: Mapping[str, object]
    stated_errors: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Everything in the types JSON knows."""
        return {
            "seed": self.seed,
            "effects": list(self.effects),
            "amplitudes": plain(self.amplitudes),
            "theta": dict(self.theta),
            "signal": self.signal,
            "is_largest": self.is_largest,
            "lines": plain(self.lines),
            "facts": plain(self.facts),
            "stated_errors": dict(self.stated_errors),
        }


def write_truth(truth: Truth, folder: PathLike) -> Path:
    """Path of the sealed file in `folder`, which nobody reads by accident.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    text = json.dumps(truth.to_dict(), allow_nan=False)
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
