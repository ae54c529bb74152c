"""OpenSim storages (``.sto``, ``.mot``): their heads, and how OpenSim counts angles in them."""

import re
from collections.abc import Iterable
from enum import Enum, unique
from typing import TextIO

SUFFIXES, MOTION, END = (".sto", ".mot"), ".mot", "endheader"
DEG = 57.29577951308232
# A factor that turns radians into degrees, to the digits that people write.
IN_DEGREES = (57.2, 57.4)
_STATED = re.compile(r"(\w+)[ \t=]+(.*)")


@unique
class Counted(Enum):
    """How angles of a storage are counted, and what says so."""

    DEGREES = "degrees"
    RADIANS = "radians"
    # No line says so, and OpenSim takes them for radians.
    RADIANS_UNSAID = "radians unsaid"
    # OpenSim takes them for degrees whatever the line says.
    CONTRADICTED = "contradicted"


def as_csv(file: TextIO) -> str:
    """An OpenSim storage with its head as comments, line by line; cells that say nan are blank."""
    lines, is_head = [], True
    for line in file:
        words = ["" if x.lower() == "nan" else x for x in line.split()]
        lines.append(f"# {line.strip().lstrip('# ')}" if is_head else "\t".join(words))
        is_head = is_head and line.strip().lower() != END
    return "\n".join(lines)


def counted(head: Iterable[str], suffix: str) -> Counted:
    """How OpenSim counts the angles of a storage with these lines of its head.

    As OpenSim 4 reads them: ``inDegrees`` with ``yes`` or ``y`` states degrees and with any other
    word radians, and where it is missing angles are radians. Of old files, without a version, the
    head may say "Angles are in degrees.", and those called ``.mot`` have degrees whatever they say.

    Examples
    --------
    >>> counted(["version=1", "inDegrees=yes"], ".sto").value, counted([], ".mot").value
    ('degrees', 'degrees')
    >>> counted(["version=1"], ".mot").value
    'radians unsaid'
    """
    lines = [x.strip() for x in head]
    stated = {found[1]: found[2].strip() for x in lines if (found := _STATED.fullmatch(x))}
    word = stated.get("inDegrees")
    is_old = re.match(r"[1-9]", stated.get("version", "0")) is None
    said = None if word is None else word.lower() in {"yes", "y"}
    if is_old and suffix.lower() == MOTION:
        return Counted.CONTRADICTED if said is False else Counted.DEGREES
    if is_old and said is None:
        words = {"Angles are in degrees.": True, "Angles are in radians.": False}
        said = next((words[x] for x in lines if x in words), None)
    if said is None:
        return Counted.RADIANS_UNSAID
    return Counted.DEGREES if said else Counted.RADIANS
