"""What a stated error known better would tell, in the currency in which trials are compared."""

from collections.abc import Sequence

import numpy as np

from identknee.diagnosis.advice.isolability import Pair
from identknee.diagnosis.explanations.refit import Refit, Rival
from identknee.identify.design.better_known import SHARE
from identknee.identify.nuisances import nuisance_places
from identknee.runs.arrays import Array


def measured_errors(
    best: Refit, rivals: Sequence[Rival], pairs: Sequence[Pair], n_columns: int
) -> dict[str, Array]:
    """Each stated error measured so well that its prior narrows to half, as rows of data.

    Explanations that fit alike may hold such an error to be different; then its measurement speaks
    for one of them, beside what the base parameters can no longer take on themselves.

    Parameters
    ----------
    best, rivals
        The explanations.
    pairs
        Where the difference between them is a column, one a rival.
    n_columns
        Columns of the table, those of the base parameters first.

    Returns
    -------
    measured
        By the name of the error, rows in units of their noise, shape ``(k, n_columns)``.
    """
    parameters = best.fitted.model.parameters
    made = {}
    for name, places in nuisance_places(parameters).items():
        per_unit = np.sqrt(SHARE**-2 - 1.0) / parameters.prior_sd[places]
        rows = np.zeros((len(places), n_columns))
        rows[np.arange(len(places)), places] = per_unit
        for rival, pair in zip(rivals, pairs, strict=True):
            apart = best.fitted.theta[places] - rival.refit.fitted.theta[places]
            rows[:, pair.effect[0]] = per_unit * apart
        made[name] = rows
    return made
