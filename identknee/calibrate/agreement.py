"""Whether terms of the evidence agree: experiments, states and forces fitted together and alone.

References
----------
.. [1] Maltoni and Schwetz (2003), Phys. Rev. D 68, 033020, equation 8.
       https://doi.org/10.1103/PhysRevD.68.033020
"""

from collections.abc import Mapping, Sequence

import numpy as np

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import (
    Problem,
    SelectedResiduals,
    n_prior_rows,
    sum_of_squares,
)
from identknee.runs.declare import Array, IntArray, declared, entry
from identknee.runs.record import Outcome

N_DRAWS, BUDGET = 1999, 60
# Share of the longest column of a Jacobian below which a parameter has no effect.
NO_EFFECT = 1e-9


@declared
class TermAgreement:
    """The fit of one term of the evidence, together with the other terms and alone."""

    name: str = entry("Name of the term")
    n: int = entry("Number of values", unit="1")
    together: float = entry("Its deviance at the fit to all terms, with the priors", unit="1")
    alone: float = entry("The least deviance of it and the priors alone", unit="1")
    p_value: float = entry(
        "How often terms that agree differ so far in this one, by the linear model", unit="1"
    )

    @property
    def rise(self) -> float:
        """Fall of the deviance if the term is fitted alone."""
        return self.together - self.alone


@declared
class Agreement:
    """Whether the terms of the evidence agree in the parameters that they share."""

    terms: tuple[TermAgreement, ...] = entry("The terms")
    difference: float = entry(
        "Deviance of the fit to all less those of the fits to each, with the priors once in each",
        unit="1",
    )
    p_value: float = entry("How often terms that agree differ so far", unit="1")
    inflation: float = entry(
        "Factor of the variance of the noise that the fits to single terms show; at least 1",
        unit="1",
    )

    @property
    def worst(self) -> TermAgreement:
        """The term that is least likely to agree with the others."""
        return min(self.terms, key=lambda x: (x.p_value, -x.rise))


def agreement(
    problem: Problem,
    theta: Array,
    terms: Mapping[str, IntArray],
    *,
    starts: Sequence[Array] = (),
    seed: int = 0,
) -> Agreement:
    """Compare the fit to all terms with the fits to each.

    The measure is the parameter goodness of fit of Maltoni and Schwetz, equation 8.

    Each term is fitted alone from the fit to all and from `starts`, with its own copy of all
    parameters and their priors. Differences between terms that agree are simulated with the model
    linearised at the fit to all; there parameters at a bound are fixed. If even the single terms
    are fitted worse than their noise allows, the noise is scaled up to match.

    Parameters
    ----------
    problem
        Residuals in units of their noise, those of priors last.
    theta
        The best fit to all, shape ``(p,)``.
    terms
        Indices of the residuals of each term, by its name; two terms or more.
    starts
        Further thetas where fits to single terms begin: the minimum of one term may be far away.
    seed
        Seed of the draws.
    """
    residuals, jacobian = problem.residuals(theta), problem.jacobian(theta)
    m = residuals.size - n_prior_rows(problem)
    priors = np.arange(m, residuals.size)
    places = {name: np.r_[rows, priors] for name, rows in terms.items()}
    used = np.r_[np.concatenate(list(terms.values())), priors]
    alone = {
        name: min(_alone(problem, rows, (theta, *starts)), sum_of_squares(residuals[rows]))
        for name, rows in places.items()
    }
    together = {name: sum_of_squares(residuals[rows]) for name, rows in places.items()}
    own = problem.parameters
    is_free = (theta > own.lower) & (theta < own.upper)
    bases = {name: _basis(jacobian[rows]) for name, rows in places.items()}
    whole = _basis(jacobian[used][:, is_free])
    degrees = sum(rows.size - bases[name].shape[1] for name, rows in places.items())
    inflation = max(1.0, sum(alone.values()) / max(degrees, 1))
    drawn = np.random.default_rng(seed).standard_normal((residuals.size, N_DRAWS))
    left = np.array(drawn)
    left[used] -= whole @ (whole.T @ drawn[used])
    rises = {
        name: np.sum(left[rows] ** 2, axis=0)
        - np.sum(drawn[rows] ** 2, axis=0)
        + np.sum((bases[name].T @ drawn[rows]) ** 2, axis=0)
        for name, rows in places.items()
    }
    # Priors count in every term alone, and once together.
    repeated = (len(places) - 1) * np.sum(left[priors] ** 2, axis=0)
    repeated_here = (len(places) - 1) * sum_of_squares(residuals[priors])
    difference = sum(together[x] - alone[x] for x in places) - repeated_here
    return Agreement(
        terms=tuple(
            TermAgreement(
                name=name,
                n=len(terms[name]),
                together=together[name],
                alone=alone[name],
                p_value=_share(rises[name], (together[name] - alone[name]) / inflation),
            )
            for name in places
        ),
        difference=difference,
        p_value=_share(np.sum(list(rises.values()), axis=0) - repeated, difference / inflation),
        inflation=inflation,
    )


def _alone(problem: Problem, rows: IntArray, starts: Sequence[Array]) -> float:
    """The least deviance of some residuals; only the lowest of the short searches is completed."""
    term = SelectedResiduals(problem=problem, rows=rows)
    lowest = min((fit(term, x, budget=BUDGET) for x in starts), key=lambda x: x.objective)
    if lowest.outcome is Outcome.BUDGET:
        lowest = fit(term, lowest.theta)
    return 2.0 * lowest.objective


def _basis(jacobian: Array) -> Array:
    """Orthonormal basis of the changes of residuals by the parameters, shape ``(m, r)``."""
    lengths = np.linalg.norm(jacobian, axis=0)
    columns = jacobian[:, lengths > NO_EFFECT * lengths.max(initial=0.0)]
    if not columns.size:
        return np.zeros((len(jacobian), 0))
    scaled = columns / np.linalg.norm(columns, axis=0)
    left, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, sizes > NO_EFFECT * sizes[0]])


def _share(drawn: Array, found: float) -> float:
    return float((1 + np.sum(drawn >= found)) / (1 + drawn.size))
