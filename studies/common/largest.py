"""The largest values of groups of trials."""

from collections.abc import Sequence

import numpy as np

from identknee.runs.declare import Array


def largest_by(values: Array, labels: Sequence[object], order: Sequence[object]) -> Array:
    """Largest of `values` (n, m) among the rows of each label, shape ``(len(order), m)``.

    Parameters
    ----------
    values
        With a row a trial; NaN is left out.
    labels
        Labels of the rows.
    order
        The labels wanted. One without a number gives NaN.
    """
    table = np.full((len(order), values.shape[1]), np.nan)
    for row, wanted in enumerate(order):
        chosen = values[[label == wanted for label in labels]]
        known = ~np.isnan(chosen)
        some = known.any(axis=0)
        table[row, some] = np.where(known, chosen, -np.inf).max(axis=0, initial=-np.inf)[some]
    return table
