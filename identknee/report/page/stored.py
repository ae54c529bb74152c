"""Results as the library's own types again, from what a verb stored of them."""

import numpy as np
import xarray

from identknee.runs.arrays import Array


def coordinates(dataset: xarray.Dataset, name: str = "coordinates") -> Array:
    """A variable by trial and coordinate, shape ``(n, 5)``."""
    return np.asarray(dataset[name].transpose(..., "trial", "coordinate").values, dtype=np.float64)
