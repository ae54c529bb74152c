"""Comment lines of a laxity table that state something: its zero, its correlation."""

import math
import re

from identknee.laxity.cells import NUMBER, CellFile
from identknee.laxity.curves import LEVELS
from identknee.laxity.protocol import Protocol
from identknee.laxity.zeros import ZEROS, zero_fault
from identknee.runs.arrays import Array

# Five errors can share a correlation above -1/4 only: their covariance must stay positive.
CORRELATION_LIMITS = (-0.25, 1.0)
STATEMENT = re.compile(r"(within_trial_correlation|zero|column|levels)\s*:\s*(.*)", re.IGNORECASE)


def correlation_fault(value: float) -> tuple[str, str] | None:
    """What is wrong with a within-trial correlation, and its remedy; None if all is well."""
    low, high = CORRELATION_LIMITS
    if low < value < high:
        return None
    why = f"the within-trial correlation is {value:g}"
    return why, f"It must lie above {low:g} and below {high:g}"


def statements(
    file: CellFile, protocol: Protocol, coordinates: Array
) -> tuple[tuple[str, ...], float, str]:
    """Free comments, within-trial correlation and zero."""
    free: list[str] = []
    stated: dict[str, str] = {"within_trial_correlation": "0", "zero": "absolute"}
    lines: dict[str, int] = {}
    for line, text in file.comments:
        found = STATEMENT.fullmatch(text)
        if found is None:
            free.append(text)
            continue
        if found[1].lower() in {"column", "levels"}:
            continue
        # A spreadsheet pads every line with separators.
        name, value = found[1].lower(), found[2].rstrip(",; ")
        if name in lines:
            file.refuse(line, "", f"{name} is stated in row {lines[name]} too", "Remove one.")
        lines[name], stated[name] = line, value
    try:
        correlation = float(stated["within_trial_correlation"])
    except ValueError:
        correlation = math.nan
    if fault := correlation_fault(correlation):
        file.refuse(lines["within_trial_correlation"], "", fault[0], f"{fault[1]}.")
    word = stated["zero"].lower()
    zero = word if word in ZEROS else stated["zero"]
    if fault := zero_fault(zero, protocol, coordinates):
        file.refuse(lines["zero"], "", fault[0], f"{fault[1]}.")
    return tuple(free), correlation, zero


def levels(file: CellFile) -> tuple[float, ...]:
    """Levels of the load at which loading curves are read [% of what every cycle reaches]."""
    for line, text in file.comments:
        name, _, words = text.partition(":")
        if name.strip().lower() == "levels":
            numbers = [x for x in re.split(r"[,;%\s]+", words) if x]
            known = tuple(float(x) for x in numbers if NUMBER.fullmatch(x))
            if known and len(known) == len(numbers) and 0.0 < min(known) <= max(known) <= 100.0:
                return tuple(dict.fromkeys(known))
            why = f"{words.strip()!r} are no levels of a load"
            file.refuse(line, "", why, "Write percentages above 0, such as: # levels: 50, 100.")
    return LEVELS
