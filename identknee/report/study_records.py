"""What the research studies share: their knees, and the head of their records."""

import json
import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from identknee.runs.files import PathLike, digest, plain, prepare_folder, write_atomically
from identknee.runs.record import versions
from identknee.subject.folder import example
from identknee.subject.knee import Knee
from identknee.subject.opensim import import_opensim

BUNDLES = "lenhart2015_bundles"
DIGITS = 6


def study_knee(name: str) -> Knee:
    """The named subject called `name`, or ``"lenhart2015_bundles"``: its OpenSim model as it is."""
    return import_opensim("lenhart2015") if name == BUNDLES else example(name)


def knee_digest(knee: Knee) -> str:
    """SHA-256 of all numbers of a knee: surfaces, frames and ligaments."""
    parts: list[bytes] = []
    for surface in (knee.femur, *knee.tibia):
        parts += [surface.vertices.tobytes(), surface.faces.tobytes()]
    for frame in (knee.femur_frame, knee.tibia_frame):
        parts += [frame.origin.tobytes(), frame.axes.tobytes()]
    for ligament in knee.ligaments:
        numbers = (ligament.stiffness_kN, ligament.reference_strain_pct)
        parts += [f"{ligament.name} {numbers}".encode()]
        parts += [ligament.femur.tobytes(), ligament.tibia.tobytes()]
    return digest(b"".join(parts))


def record_head(
    command: str, *, settings: Mapping[str, Any], inputs: Mapping[str, str]
) -> dict[str, Any]:
    """Head of a study's record: how it was made, when, from what and on which machine.

    Parameters
    ----------
    command
        What to type to make it again.
    settings
        Every setting by name, seeds included.
    inputs
        SHA-256 of each input by name.
    """
    return {
        "command": command,
        "commit": commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": {"cores": os.cpu_count(), "processor": processor()},
        "versions": versions(),
        "settings": dict(settings),
        "inputs": dict(inputs),
    }


def commit() -> str:
    """Commit of the checkout that holds this package, marked where files differ from it.

    ``"unknown"`` where there is no checkout or no git.
    """
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()


def processor() -> str:
    """Name of the processor, as far as the system tells."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.machine()


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """`value` with every number cut to so many significant digits; arrays become lists.

    Examples
    --------
    >>> rounded({"k": np.array([1.23456789, 0.0])}, 3)
    {'k': [1.23, 0.0]}
    """
    if isinstance(value, Mapping):
        return {key: rounded(item, digits) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return rounded(value.tolist(), digits)
    if isinstance(value, list | tuple):
        return [rounded(item, digits) for item in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.{digits}g}")
    return value


def write_record(path: PathLike, record: Mapping[str, Any]) -> Path:
    """Path of a JSON file that now holds `record`, a line for each innermost mapping or list.

    Its folder is made where it is missing; infinity and NaN become ``null``.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    target = Path(path)
    prepare_folder(target.parent)
    return write_atomically(target, _pretty(plain(record), "") + "\n")


def _pretty(value: Any, indent: str) -> str:
    inner = indent + " "
    if isinstance(value, dict) and any(_is_deep(x) for x in value.values()):
        rows = [f"{json.dumps(key)}: {_pretty(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(inner + row for row in rows) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(x, dict) for x in value):
        rows = [json.dumps(x, ensure_ascii=False) for x in value]
        return "[\n" + ",\n".join(inner + row for row in rows) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False)


def _is_deep(value: Any) -> bool:
    return isinstance(value, dict | list)
