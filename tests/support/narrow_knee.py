"""The reference knee with narrower plateaus, as where the segmented cartilage ends early."""

import tomllib
from dataclasses import replace
from functools import lru_cache
from importlib import resources

from identknee.subject import reference
from identknee.subject.knee import Knee
from identknee.subject.reference import Plateau


@lru_cache(maxsize=4)
def narrow_knee(share: float = 0.6, edge_mm: float = reference.EDGE_MM) -> Knee:
    """The reference knee with plateaus of this share of its width, about the same centres."""
    file = resources.files("identknee.subject").joinpath("reference_knee.toml")
    numbers = tomllib.loads(file.read_text("utf-8"))["tibia"]
    plateaus = [Plateau(**reference._values(numbers[side])) for side in ("medial", "lateral")]
    narrow = [replace(x, half_width=share * x.half_width) for x in plateaus]
    return replace(
        reference.reference_knee(edge_mm),
        name="narrow",
        tibia=tuple(x.mesh(edge_mm) for x in narrow),
    )
