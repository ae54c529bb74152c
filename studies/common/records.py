"""How a study is computed: its options, its knees, and its record with how that was made."""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

import identknee as ik
from identknee.runs.files import PathLike, plain
from identknee.runs.record import versions

Row = dict[str, Any]
Kept = Callable[[Callable[[Any], Any], Sequence[Any], str], list[Any]]

BUNDLES = "lenhart2015_bundles"
DIGITS = 6


def study_knee(name: str) -> ik.Knee:
    """The named subject called `name`, or ``"lenhart2015_bundles"``: its straight lines.

    Each of its bundles is a ligament of its own, tied to no other.
    """
    if name == BUNDLES:
        return replace(ik.import_opensim("lenhart2015", wrapping=False), groups=())
    return ik.example(name)


def knee_digest(knee: ik.Knee) -> str:
    """SHA-256 of all numbers of a knee: surfaces, frames and ligaments.

    Stiffnesses, strains and the axes of frames count to nine digits: those that come from a norm
    or a rotation have last bits that hang on the processor.
    """
    parts: list[bytes] = []
    for surface in (knee.femur, *knee.tibia):
        parts += [surface.vertices.tobytes(), surface.faces.tobytes()]
    for frame in (knee.femur_frame, knee.tibia_frame):
        # A zero has no sign.
        parts += [frame.origin.tobytes(), (np.round(frame.axes, 9) + 0.0).tobytes()]
    for ligament in knee.ligaments:
        numbers = f"{ligament.stiffness_kN:.9g} {ligament.reference_strain_pct:.9g}"
        parts += [f"{ligament.name} {numbers}".encode()]
        parts += [ligament.femur.tobytes(), ligament.tibia.tobytes()]
    return ik.runs.digest(b"".join(parts))


def parsed_options(
    file: str, quick: str = "", parts: Sequence[str] = (), **numbers: int
) -> argparse.Namespace:
    """What was asked of a study's computation.

    Parameters
    ----------
    file
        The script; its folder is the study's.
    quick
        What the small version leaves; without it there is none.
    parts
        Parts of the record that can be computed alone.
    numbers
        Further options that are whole numbers, with their defaults.
    """
    folder = Path(file).parent
    record = next((folder / "records").glob("*.json"))
    store = platformdirs.user_cache_path("identknee") / "studies" / record.stem
    parser = argparse.ArgumentParser(description=f"Computes the record of study {folder.name}.")
    parser.add_argument("--store", type=Path, default=store, help="folder of finished work")
    parser.add_argument("--record", type=Path, default=record, help="the file to write")
    parser.add_argument("--workers", type=int, default=2)
    for name, default in numbers.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=default)
    if parts:
        parser.add_argument(
            "--part",
            action="append",
            choices=parts,
            default=[],
            help="compute this part alone; all others stay as they are",
        )
    if quick:
        parser.add_argument("--quick", action="store_true", help=quick)
    words = ["python", f"studies/{folder.name}/compute.py", *sys.argv[1:]]
    parser.set_defaults(command=" ".join(words))
    return parser.parse_args()


def begun(options: argparse.Namespace, knees: Iterable[str], **settings: Any) -> Row:
    """A record that says how it was made, when, from what and on which machine, and no more yet.

    Parameters
    ----------
    options
        As `parsed_options` gives them; they are settings, but for where files are.
    knees
        Names of the knees, whose digests are the inputs.
    settings
        Every other setting by name, seeds included.
    """
    places = ("store", "record", "command", "part")
    given = {name: value for name, value in vars(options).items() if name not in places}
    head = {
        "command": options.command,
        "commit": commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": {"cores": os.cpu_count(), "processor": processor()},
        "versions": versions(),
        "settings": {**given, **settings},
        "inputs": {name: knee_digest(study_knee(name)) for name in knees},
    }
    return {"head": head, "knees": {}}


def begun_again(options: argparse.Namespace, record: Row) -> Row:
    """The record as it was written, whose head says of `options.part` how it was made instead.

    Parameters
    ----------
    options
        As `parsed_options` gives them.
    record
        As `begun` makes it now.
    """
    known: Row = json.loads(options.record.read_text())
    own = {x: record["head"][x] for x in ("command", "commit", "date", "machine", "versions")}
    known["head"]["parts"] = {**known["head"].get("parts", {}), **dict.fromkeys(options.part, own)}
    return known


@contextmanager
def working(options: argparse.Namespace, **settings: Any) -> Iterator[Kept]:
    """A map over items in worker processes; what is done is in the store and not done again.

    Parameters
    ----------
    options
        As `parsed_options` gives them.
    settings
        What the work depends on: with others the store is refused.
    """
    with (
        ik.runs.open_work(options.store.with_suffix(".sqlite"), settings) as store,
        ik.runs.process_pool(options.workers) as executor,
    ):

        def kept(work: Callable[[Any], Any], items: Sequence[Any], name: str) -> list[Any]:
            began = time.perf_counter()
            found = ik.runs.resumable_map(
                work, items, executor=executor, store=store, name=name, description=name
            )
            say(f"{name}, {time.perf_counter() - began:.0f} s")
            return found

        yield kept


def say(text: str) -> None:
    """Tell how far it is."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


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
    ik.runs.prepare_folder(target.parent)
    return ik.runs.write_atomically(target, _pretty(plain(record), "") + "\n")


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
