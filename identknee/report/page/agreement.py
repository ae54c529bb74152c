"""Whether the arrays of a result and its summary speak of the same things."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray

Groups = Mapping[str, xarray.Dataset]


def disagreement(summary: Mapping[str, Any], groups: Groups) -> tuple[str, str] | None:
    """The first place in the arrays that does not fit the summary, and why; None without.

    Parameters
    ----------
    summary
        As its schema wants it.
    groups
        The arrays, as theirs wants them.
    """
    checks = (_draws,)
    return next((found for check in checks for found in check(summary, groups)), None)


def _draws(_: Mapping[str, Any], groups: Groups) -> Iterator[tuple[str, str]]:
    """One variable for all parameters, or one for each."""
    for name in ("prior", "posterior"):
        if name not in groups:
            continue
        data = groups[name]
        if "theta" in data and ("parameter" not in data or "parameter" not in data["theta"].dims):
            yield f"group {name}, variable theta", "it does not say of which parameters it is"
        if not data.data_vars or not all(
            x.dtype.kind == "f" and x.size and np.isfinite(x.values).all()
            for x in data.data_vars.values()
        ):
            yield f"group {name}", "some of its draws are missing"
