"""Draws of a posterior from the arrays that a sample left."""

import math
from pathlib import Path

import numpy as np
import xarray

from identknee.runs.arrays import Array
from identknee.runs.errors import InputError
from identknee.runs.files import PathLike

ARRAYS, POSTERIOR, THETA = "result.nc", "posterior", "theta"


def posterior_draws(folder: PathLike, names: tuple[str, ...], n: int) -> Array:
    """At most n draws of the parameters called `names` from what ``identknee sample`` left.

    They are evenly spread over all chains and steps, shape ``(n, p)``.

    Raises
    ------
    InputError
        If the folder has no posterior, or that of other parameters.
    """
    path = Path(folder) / ARRAYS
    remedy = "Give the folder --out of an identknee sample that has ended."
    if not path.is_file():
        raise InputError(path, "", "there are no results to read", remedy)
    try:
        tree = xarray.open_datatree(path, engine="h5netcdf")
    except OSError as error:
        raise InputError(path, "", f"there are no results to read ({error})", remedy) from error
    with tree:
        if POSTERIOR not in tree.children:
            raise InputError(path, "", "there is no posterior in these results", remedy)
        data = tree[POSTERIOR].to_dataset().load()
    draws = _by_name(data, names)
    if draws is None:
        why = f"its posterior is not one of {', '.join(names)}"
        raise InputError(path, POSTERIOR, why, "Sample and analyse with the same --fix.")
    step = max(1, math.ceil(len(draws) / n))
    return np.asarray(draws[::step])


def _by_name(data: xarray.Dataset, names: tuple[str, ...]) -> Array | None:
    """Draws of the parameters in this order, from one variable for all or one for each."""
    if THETA in data:
        theta = data[THETA]
        known = [str(x) for x in theta["parameter"].values] if "parameter" in theta.coords else []
        if set(known) != set(names):
            return None
        values = theta.transpose(..., "parameter").sel(parameter=list(names)).values
        return np.asarray(values.reshape(-1, len(names)), dtype=np.float64)
    if not all(name in data for name in names):
        return None
    return np.column_stack([data[name].values.ravel() for name in names])
