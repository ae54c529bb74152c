"""Parameters that are many and alike, of which derivatives need not all be compared."""

import re
from collections.abc import Sequence

# A coordinate of a place on a bone; there are three of each end of each line.
PLACE = re.compile(r"(?!.*(?:registration|reference_pose))[\w/]+\.\w+_[xyz]_mm")
# Of these one is kept: of five along all axes, on both bones and for every ligament in turn.
EVERY = 5


def few_places(names: Sequence[str]) -> list[int]:
    """Indices of all parameters, but of coordinates of places of every fifth alone."""
    places = [i for i, name in enumerate(names) if PLACE.fullmatch(name)]
    left_out = set(places) - set(places[::EVERY])
    return [i for i in range(len(names)) if i not in left_out]
