"""The unit of every array in a result, where readers of xarray look for it."""

from collections.abc import Mapping

import xarray

AS_PARAMETER = "kN or %, as the parameter's name says"
AS_COORDINATE = "mm or deg, as the coordinate's name says"
AS_QUANTITY = "the unit of the quantity, beside it as `unit`"
PLAIN = "1"
NUMERIC = "fiu"

SUFFIXES = {
    "_N_per_mm": "N/mm",
    "_mm": "mm",
    "_deg": "deg",
    "_Nm": "N m",
    "_N": "N",
    "_kN": "kN",
    "_pct": "%",
}
# Whatever it varies over.
BY_NAME = {
    "loads": "N or N m, as the load's name says",
    "slope": "1 over the unit of the quantity",
    "best_objective": "1, or mm2 and deg2 where the weighting is unit",
}
# Values of what they vary over, by the dimension that says so; other arrays are plain numbers.
BY_DIMENSION = {
    "parameter": (
        AS_PARAMETER,
        (*("theta", "optimum", "start", "fit", "lower", "upper", "sd", "step"),),
    ),
    "member": (AS_PARAMETER, ("edge", "optimum", "reached")),
    "coordinate": (
        AS_COORDINATE,
        ("coordinates", "sd", "change_by_contact_points", "before", "after"),
    ),
    "quantity": (
        AS_QUANTITY,
        (
            *("value", "optimum_value", "interval", "nested", "lower", "upper", "at_fit"),
            *("lower_error", "upper_error", "lower_reached", "upper_reached"),
        ),
    ),
}


def with_units(groups: Mapping[str, xarray.Dataset]) -> dict[str, xarray.Dataset]:
    """The groups, every array of numbers with its unit as the attribute ``units``; 1 for none."""
    found = {name: dataset.copy() for name, dataset in groups.items()}
    for dataset in found.values():
        for name, variable in dataset.variables.items():
            if variable.dtype.kind in NUMERIC:
                dataset[name].attrs.setdefault("units", unit(str(name), variable.dims))
    return found


def unit(name: str, dimensions: tuple[object, ...]) -> str:
    """Unit of the array called `name` that varies over `dimensions`.

    Examples
    --------
    >>> unit("tension_N", ("trial", "ligament"))
    'N'
    >>> unit("sd", ("parameter",))
    "kN or %, as the parameter's name says"
    >>> unit("eigenvalue", ("direction",))
    '1'
    """
    if name in BY_NAME:
        return BY_NAME[name]
    for dimension, (its_unit, names) in BY_DIMENSION.items():
        if dimension in dimensions and name in names:
            return its_unit
    return next((x for suffix, x in SUFFIXES.items() if name.endswith(suffix)), PLAIN)
