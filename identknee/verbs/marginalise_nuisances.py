"""Stated errors of geometry and tests, marginalised to first order instead of fitted."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from identknee.calibrate.fit import Fit
from identknee.calibrate.problem import (
    TABLE_TERM,
    BoundedProblem,
    Problem,
    SumOfTerms,
    innermost,
    restricted,
    with_priors_of,
)
from identknee.checks.usable_trials import residuals_of
from identknee.identify.design import MarginalProblem
from identknee.model.effects.effect import with_fixed_amplitudes
from identknee.model.force_residuals import ForceResiduals, SuperpositionResiduals
from identknee.model.laxity_model import LaxityModel
from identknee.model.limit_residuals import LimitResiduals
from identknee.model.residuals import LaxityResiduals, has_shared_errors, shared_errors
from identknee.runs.declare import Array
from identknee.runs.executors import Executor
from identknee.verbs.identification import Identification, best_fits

# Draws of the errors that show how far predictions are from straight lines, and their seed.
N_DRAWS, DRAWS_SEED = 16, 0


def marginalise_nuisances(
    setup: Identification, *, seed: int, executor: Executor
) -> tuple[Identification, tuple[Fit, ...]]:
    """The problem with marginalised nuisances, which starts at the best fit.

    Around the best fit nuisances change predictions along straight lines. Their priors then add
    to the covariance of the noise, ``V = noise + J C J'``, and leave no parameter behind. Far from
    it they do not, so the question is not fitted again.

    Parameters
    ----------
    setup
        The question, nuisances with their priors among its parameters.
    seed
        Seed of the starts of the fits.
    executor
        Anything with an ordered ``map``.

    Returns
    -------
    setup
        The question; the one given where it has no nuisances.
    fits
        Those of all parameters, the lowest first.

    Raises
    ------
    ValueError
        If there are nuisances and the data state no noise.
    NotComputable
        If no parameters near the start have a prediction in every measured trial.
    """
    if not setup.problem.parameters.nuisance_names:
        return setup, best_fits(setup, seed=seed, executor=executor)
    if setup.degrees_of_freedom is not None:
        raise ValueError(
            "stated errors can be marginalised only if the noise is stated; add --noise, for "
            "example --noise 0.5mm,0.5deg, or treat the geometry as exact with --uncertain none"
        )
    fits = best_fits(setup, seed=seed, executor=executor)
    return _about(setup, fits[0].theta), fits


def _about(setup: Identification, best: Array) -> Identification:
    """The problem of the parameters of interest, nuisances marginalised at a best fit."""
    theta, everything = setup.free.expand(best), setup.free.everything
    has_terms = isinstance(innermost(setup.problem), SumOfTerms)
    linear = (_linearised_terms if has_terms else _linearised_residuals)(setup, theta)
    asked, nuisances = setup.problem.parameters.names_of_interest, everything.nuisance_names
    kept = everything.with_fixed(nuisances, theta)
    bounded = BoundedProblem(problem=linear, parameters=kept.parameters)
    fixed = [name for name in kept.parameters.names if name not in asked]
    free = everything.with_fixed([*fixed, *nuisances], theta)
    sentence = (
        f"{setup.problem.parameters.n - len(asked)} stated errors were marginalised to first "
        f"order at the best fit, which predictions use. {_nonlinearity(setup, linear, theta)}"
    )
    problem = with_priors_of(restricted(bounded, fixed, kept.restrict(theta)), setup.problem)
    return replace(
        setup,
        problem=problem,
        everywhere=problem,
        free=free,
        start=free.restrict(theta),
        nuisances_at=(setup.problem, best),
        assumptions=(*setup.assumptions, sentence),
    )


def _linearised_residuals(setup: Identification, theta: Array) -> LaxityResiduals:
    """Residuals whose covariance holds the nuisances, their means at the priors' middles."""
    everything = setup.free.everything
    varied = ~everything.is_of_interest
    _, jacobian = _tangent(setup, theta)
    slopes = jacobian[:, :, varied]
    columns = slopes * everything.prior_sd[varied]
    if has_shared_errors(setup.knee.uncertainty):
        columns = np.concatenate([columns, shared_errors(setup.model, theta)], axis=2)
    if setup.discrepancy is not None:
        columns = np.concatenate([columns, setup.discrepancy.columns], axis=2)
    return LaxityResiduals(
        model=_with_fixed_nuisances(setup.model, theta),
        laxity=setup.laxity,
        weighting="noise",
        shared=columns,
        offset=slopes @ (everything.center - theta)[varied],
    )


def _linearised_terms(setup: Identification, theta: Array) -> MarginalProblem:
    """The marginal problem of a table with forces or limits, which share its errors."""
    everything, whole = setup.free.everything, _terms(setup)
    varied = ~everything.is_of_interest
    table = residuals_of(whole)
    table = replace(table, model=_with_fixed_nuisances(setup.model, theta))
    model = table.model
    terms: dict[str, Problem] = {TABLE_TERM: table}
    for name, term in whole.terms.items():
        if isinstance(term, ForceResiduals | LimitResiduals):
            terms[name] = replace(term, model=model)
        elif isinstance(term, SuperpositionResiduals):
            offset = term.offset_at(theta)
            terms[name] = replace(term, model=model, offset=offset)
    slopes, sd = whole.jacobian(theta)[:, varied], everything.prior_sd[varied]
    return MarginalProblem(
        problem=SumOfTerms(terms=terms, sizes=whole.sizes),
        slopes=slopes * sd,
        offset=(everything.center - theta)[varied] / sd,
    )


def _terms(setup: Identification) -> SumOfTerms:
    whole = innermost(setup.problem)
    if not isinstance(whole, SumOfTerms):
        raise TypeError(f"{type(whole).__name__} has no terms")
    return whole


def _with_fixed_nuisances(model: LaxityModel, theta: Array) -> LaxityModel:
    """The model with its nuisances fixed at theta: their derivatives are most of a simulation."""
    nuisances = set(model.parameters.nuisance_names)
    values = dict(zip(model.parameters.names, theta.tolist(), strict=True))
    return model.with_effects(
        [
            with_fixed_amplitudes(x, {name: values[name] for name in x.parameters.names})
            if nuisances.issuperset(x.parameters.names)
            else x
            for x in model.effects
        ]
    )


def _nonlinearity(
    setup: Identification, linear: LaxityResiduals | MarginalProblem, theta: Array
) -> str:
    """Nonlinearity of predictions over draws of the errors, as a sentence."""
    everything = setup.free.everything
    varied = ~everything.is_of_interest
    generator = np.random.default_rng(DRAWS_SEED)
    bent = _bent_residuals(setup, linear, theta)
    squares = []
    for _ in range(N_DRAWS):
        step = np.zeros(everything.n)
        step[varied] = generator.normal(scale=everything.prior_sd[varied])
        step = np.clip(theta + step, everything.lower, everything.upper) - theta
        rows = bent(step)
        # A draw without an equilibrium in some trial tells nothing.
        if np.isfinite(rows).all():
            squares.append(np.mean(rows**2))
    if not squares:
        return (
            "No draw from their priors has a prediction in every trial: the result may be "
            "inaccurate."
        )
    return (
        "Drawn from their priors the nonlinearity of predictions is "
        f"{np.sqrt(np.mean(squares)):.2g} standard deviations of noise and errors together (root "
        f"mean square of {len(squares)} draws)."
    )


def _bent_residuals(
    setup: Identification, linear: LaxityResiduals | MarginalProblem, theta: Array
) -> Callable[[Array], Array]:
    """What a step from theta changes in residuals beyond a straight line, in their units."""
    if isinstance(linear, MarginalProblem):
        whole = _terms(setup)
        here, slopes = whole.residuals(theta), whole.jacobian(theta)

        def bent(step: Array) -> Array:
            there = whole.residuals(theta + step)
            is_found = np.isfinite(there).all()
            return linear.whitened(there - here - slopes @ step) if is_found else there

        return bent
    coordinates, jacobian = _tangent(setup, theta)
    predict = partial(setup.model.predict, derivatives=False)
    return lambda x: linear.rows(predict(theta + x).coordinates - coordinates - jacobian @ x)


def _tangent(setup: Identification, theta: Array) -> tuple[Array, Array]:
    """Coordinates at theta and their derivatives, shapes ``(n, 5)`` and ``(n, 5, p)``."""
    at = setup.model.predict(theta)
    return at.coordinates, at.slopes
