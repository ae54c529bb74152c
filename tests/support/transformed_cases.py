"""The conformance suite in other units, shifted and mirrored: the answers go along."""

import dataclasses

import numpy as np
from conformance.case import Case, Formula
from conformance.score import conformance_cases

from identknee.calibrate.problem import ParameterQuantity

# Moved by a shift, a bound one rounding away would be somewhere else.
SHIFTABLE = {
    case.name: case
    for case in conformance_cases()
    if isinstance(case.quantity, ParameterQuantity) and "rounding" not in case.name
}


def transformed(case: Case, seed: int) -> Case:
    """With ``theta' = scale theta + shift``, the scale of either sign and up to 1e3 or 1e-3."""
    rng = np.random.default_rng(seed)
    parameters = case.problem.parameters
    scale = 10.0 ** rng.uniform(-3.0, 3.0, parameters.n) * rng.choice([-1.0, 1.0], parameters.n)
    shift = scale * rng.uniform(-2.0, 2.0, parameters.n)
    bounds = np.sort([scale * parameters.lower + shift, scale * parameters.upper + shift], axis=0)
    moved = dataclasses.replace(
        parameters, lower=bounds[0], upper=bounds[1], center=scale * parameters.center + shift
    )
    assert isinstance(case.quantity, ParameterQuantity)
    i = case.quantity.index
    ends = np.sort(scale[i] * np.array(case.intervals) + shift[i], axis=1)
    ends = ends[np.argsort(ends[:, 0])]
    is_mirrored = scale[i] < 0
    return dataclasses.replace(
        case,
        problem=Formula(
            parameters=moved,
            residuals_at=lambda theta: case.problem.residuals((theta - shift) / scale),
            jacobian_at=lambda theta: case.problem.jacobian((theta - shift) / scale) / scale,
        ),
        quantity=ParameterQuantity(parameters=moved, name=case.quantity.name),
        optimum=np.clip(scale * case.optimum + shift, *bounds),
        intervals=tuple((float(low), float(high)) for low, high in ends),
        lower=case.upper if is_mirrored else case.lower,
        upper=case.lower if is_mirrored else case.upper,
    )
