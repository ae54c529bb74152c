"""How far a search looks in each parameter, by the parameter's unit."""

import numpy as np
from numpy.typing import ArrayLike

from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array

STIFFNESS_UNIT = "_kN"
STRAIN_UNIT = "_pct"
ROUNDING = 1e-13
# A typical step that changes the residuals by less than this changes nothing: the squares of one
# over it would overflow.
UNSEEN = 1e-100


def half_widths(parameters: Parameters) -> Array:
    """Half-widths of the box of first candidates around a start, shape ``(n,)``.

    They are 2 kN and 3 % as in the paper (section 2.5), and two prior standard deviations for
    parameters in other units.
    """
    return by_unit(parameters, 2.0, 3.0, 2.0 * parameters.prior_sd_in_own_units)


def typical_steps(parameters: Parameters) -> Array:
    """A typical uncertainty of each parameter, shape ``(n,)``: 3 kN, 2 % or the prior's sd."""
    return by_unit(parameters, 3.0, 2.0, parameters.prior_sd_in_own_units)


def conditional_sds(jacobian: Array, parameters: Parameters) -> Array:
    """Standard deviation of each parameter where all others are known, shape ``(n,)``.

    Its typical step where that says nothing: where the residuals do not change with it.
    """
    typical = typical_steps(parameters)
    size = np.linalg.norm(jacobian, axis=0)
    changes = size * typical
    known = changes > max(ROUNDING * np.max(changes, initial=0.0), UNSEEN)
    return np.where(known, 1.0 / np.where(known, size, 1.0), typical)


def floors(parameters: Parameters) -> Array:
    """The least value that has a meaning, shape ``(n,)``.

    Zero for stiffnesses and for whatever has a lognormal prior, minus infinity for the rest.
    """
    positive = [
        is_log or name.endswith(STIFFNESS_UNIT)
        for name, is_log in zip(parameters.names, parameters.is_log, strict=True)
    ]
    return np.where(positive, 0.0, -np.inf)


def by_unit(
    parameters: Parameters, stiffness: ArrayLike, strain: ArrayLike, others: Array
) -> Array:
    """Values for stiffnesses in kN, strains in % and all others, shape ``(n,)`` each or numbers."""
    is_stiffness, is_strain = (
        np.array([name.endswith(unit) for name in parameters.names])
        for unit in (STIFFNESS_UNIT, STRAIN_UNIT)
    )
    return np.where(is_stiffness, stiffness, np.where(is_strain, strain, others))
