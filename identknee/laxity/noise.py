"""Standard deviations of measured values: their plausible range, and the text that states them."""

import math
import re

# Smaller or larger than any measurement in mm or deg; squares of these keep their digits.
NOISE_LIMITS = (1e-9, 1e6)
_SIZE = re.compile(r"\s*([0-9.eE+-]+)\s*(mm|deg)\s*")
EXAMPLE = "0.3mm,0.3deg"


def noise_fault(sd: float) -> tuple[str, str] | None:
    """Why a standard deviation > 0 is implausible, and the remedy; None if it is plausible."""
    low, high = NOISE_LIMITS
    if low <= sd <= high:
        return None
    why = f"a standard deviation of {sd:g} is beyond {low:g} to {high:g}"
    return why, "Give that of the measurement, in mm or deg"


def noise_sizes(text: str, option: str = "--noise") -> tuple[float, float]:
    """Standard deviations [mm], [deg] from a text such as ``0.3mm,0.3deg``.

    Raises
    ------
    ValueError
        If the text has another form, or a size is not above zero or is implausible.

    Examples
    --------
    >>> noise_sizes("0.3mm,0.5deg")
    (0.3, 0.5)
    """
    where, sizes = f"{option} {text}", {}
    other_form = ValueError(
        f"{where}: this is not a size of noise. Write two standard deviations with their units, "
        f"the first of translations and the second of rotations, for example {option} {EXAMPLE}"
    )
    for part in text.split(","):
        found = _SIZE.fullmatch(part)
        if found is None or found[2] in sizes:
            raise other_form
        try:
            size = float(found[1])
        except ValueError:
            size = math.nan
        if not math.isfinite(size):
            raise ValueError(
                f"{where}: {found[1].strip()!r} is not a number. Write a number such as 9.5"
            )
        if size <= 0.0:
            raise ValueError(f"{where}: both must be more than 0, for example {option} {EXAMPLE}")
        if fault := noise_fault(size):
            raise ValueError(f"{where}: {'. '.join(fault)}")
        sizes[found[2]] = size
    if len(sizes) != 2:
        raise other_form
    return sizes["mm"], sizes["deg"]
