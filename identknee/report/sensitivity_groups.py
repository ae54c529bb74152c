"""A sensitivity analysis as an xarray dataset, and the groups of outputs it speaks of."""

import math
from pathlib import Path

import numpy as np
import xarray

from identknee.identify.sensitivity.sensitivity import Sensitivity
from identknee.laxity.protocol import Protocol
from identknee.laxity.table import COORDINATES
from identknee.report.comparison import load_scenarios
from identknee.report.groups import Groups
from identknee.report.result_files import ARRAYS
from identknee.runs.arrays import Array
from identknee.runs.errors import InputError

SEPARATOR = ", "
POSTERIOR = "posterior"
THETA = "theta"


def laxity_groups(protocol: Protocol) -> tuple[str, ...]:
    """Group of every coordinate of every trial: coordinate, flexion angle and kind of load.

    Examples
    --------
    >>> from identknee.laxity.protocol import load_protocol
    >>> laxity_groups(load_protocol("seed63"))[3]
    'varus_deg, 0 deg, valgus moment'
    """
    scenarios = load_scenarios(protocol)
    return tuple(
        SEPARATOR.join((coordinate, f"{flexion:g} deg", scenario))
        for flexion, scenario in zip(protocol.flexion_deg, scenarios, strict=True)
        for coordinate in COORDINATES
    )


def sensitivity_groups(found: Sensitivity) -> Groups:
    """Group ``sensitivity``: every index by group of outputs and parameter, and how it converged.

    Dimensions are ``group``, ``parameter`` and ``level``; the coordinate ``n_samples`` says how
    many blocks, trajectories or draws a level has.
    """
    dims = ("group", "parameter")
    variables: dict[str, object] = {
        "failed_share": ("group", found.failed_share),
        "complete_share": ("group", found.complete_share),
        "component_share": ("group", found.component_share),
        "more_simulations": ("group", found.more_simulations()),
    }
    for name, index in found.indices.items():
        variables[name] = (dims, index.final)
        variables[f"{name}_half_width"] = (dims, index.final_half_widths)
        variables[f"{name}_complete"] = (dims, index.complete)
        variables[f"{name}_complete_half_width"] = (dims, index.complete_half_widths)
        variables[f"{name}_by_level"] = (("level", *dims), index.values)
        variables[f"{name}_half_width_by_level"] = (("level", *dims), index.half_widths)
        if index.noise_floor is not None:
            variables[f"{name}_noise_floor"] = ("group", index.noise_floor)
    levels = next(iter(found.indices.values())).levels
    dataset = xarray.Dataset(
        variables,
        coords={
            "group": list(found.groups),
            "parameter": list(found.parameters.names),
            "n_samples": ("level", levels),
        },
        attrs={
            "method": found.method,
            "n_samples": found.n_samples,
            "n_simulations": found.n_simulations,
            "seed": found.seed,
            "failures": found.rule,
            "half_widths": "of 95 % bootstrap confidence intervals",
        },
    )
    if found.box is not None:
        dataset = dataset.assign(
            lower=("parameter", found.box.lower), upper=("parameter", found.box.upper)
        )
    return {"sensitivity": dataset}


def posterior_draws(folder: Path, names: tuple[str, ...], n: int) -> Array:
    """At most n draws of the parameters called `names` from what ``identknee sample`` left.

    They are evenly spread over all chains and steps, shape ``(n, p)``.

    Raises
    ------
    InputError
        If the folder has no posterior, or that of other parameters.
    """
    path = folder / ARRAYS
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
