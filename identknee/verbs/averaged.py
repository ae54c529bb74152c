"""Stated errors of geometry and tests, averaged over to first order instead of fitted."""

from dataclasses import replace

import numpy as np

from identknee.calibrate.fit import Fit, fit
from identknee.calibrate.problem import Bounded, restricted
from identknee.identify.marginal import marginal
from identknee.identify.optimum import best_fits as find_best_fits
from identknee.model.residuals import LaxityResiduals
from identknee.model.shared_errors import has_shared_errors, shared_errors
from identknee.runs.arrays import Array, BoolArray
from identknee.runs.executors import Executor
from identknee.verbs.identification import Identification, best_fits, check_start

# Draws of the errors that show how far predictions are from straight lines, and their seed.
N_DRAWS, DRAWS_SEED = 16, 0


def averaged(setup: Identification, *, seed: int, executor: Executor) -> Identification:
    """The same question of the parameters of interest alone; itself where it has no nuisances.

    Around the best fit nuisances change predictions along straight lines. Their priors then add
    to the covariance of the noise, ``V = noise + J C J'``, and leave no parameter behind.

    Parameters
    ----------
    setup
        The question, nuisances with their priors among its parameters.
    seed
        Seed of the starts of the fits.
    executor
        Anything with an ordered ``map``.

    Raises
    ------
    ValueError
        If there are nuisances and the data state no noise.
    NotComputed
        If no parameters near the start have a prediction in every measured trial.
    """
    nuisances = setup.problem.parameters.nuisance_names
    if not nuisances:
        return setup
    if setup.degrees_of_freedom is not None:
        raise ValueError(
            "stated errors can be averaged over only beside a stated noise; add --noise, for "
            "example --noise 0.5mm,0.5deg, or hold the geometry exact with --uncertain none"
        )
    best = best_fits(setup, seed=seed, executor=executor)[0].theta
    theta = setup.free.expand(best)
    everything = setup.free.everything
    varied = np.isin(everything.names, nuisances)
    residuals = _with_straight_lines(setup, theta, varied)
    kept = set(setup.problem.parameters.names_of_interest)
    held = [name for name in everything.names if name not in kept]
    part = restricted(Bounded(problem=residuals, parameters=everything), held, theta)
    sentence = (
        f"{len(nuisances)} stated errors were averaged over to first order at the best fit, where "
        f"predictions hold them. {_bend(setup, residuals, theta, varied)}"
    )
    return replace(
        setup,
        problem=part,
        free=part.free,
        start=part.free.restrict(setup.free.expand(setup.start)),
        nuisances_at=(setup.problem, best),
        assumptions=(*setup.assumptions, sentence),
    )


def straight_fits(setup: Identification, *, seed: int, executor: Executor) -> tuple[Fit, ...]:
    """Fits from the start and from around it, the lowest first, as `best_fits`, but sooner.

    The fits from around it have nuisances change predictions along straight lines, as at the end of
    a first fit; from the lowest of them all parameters are fitted. Without nuisances it is
    `best_fits`.

    Raises
    ------
    ValueError, NotComputed
        As `best_fits`.
    """
    is_asked = setup.problem.parameters.is_of_interest
    if is_asked.all():
        return best_fits(setup, seed=seed, executor=executor)
    check_start(setup)
    first = fit(setup.problem, setup.start, seed=seed)
    if not np.isfinite(first.objective):
        return best_fits(setup, seed=seed, executor=executor)
    part = marginal(setup.problem, first.theta)
    begun = np.array(first.theta)
    around = find_best_fits(part, start=begun[is_asked], seed=seed, executor=executor)
    begun[is_asked] = around[0].theta
    again = fit(setup.problem, begun, seed=seed)
    return tuple(sorted((first, again), key=lambda x: x.objective))


def _with_straight_lines(setup: Identification, theta: Array, varied: BoolArray) -> LaxityResiduals:
    """Residuals whose covariance holds the errors `varied`, their means at the priors' middles."""
    everything = setup.free.everything
    _, jacobian = _tangent(setup, theta)
    slopes = jacobian[:, :, varied]
    columns = slopes * everything.prior_sd[varied]
    if has_shared_errors(setup.knee.uncertainty):
        columns = np.concatenate([columns, shared_errors(setup.model, theta)], axis=2)
    return LaxityResiduals(
        model=setup.model,
        laxity=setup.laxity,
        weighting="noise",
        shared=columns,
        offset=slopes @ (everything.center - theta)[varied],
    )


def _bend(
    setup: Identification, residuals: LaxityResiduals, theta: Array, varied: BoolArray
) -> str:
    """How far draws of the errors depart from straight lines, as a sentence."""
    everything, model = setup.free.everything, setup.model
    generator = np.random.default_rng(DRAWS_SEED)
    coordinates, jacobian = _tangent(setup, theta)
    squares = []
    for _ in range(N_DRAWS):
        step = np.zeros(everything.n)
        step[varied] = generator.normal(scale=everything.prior_sd[varied])
        step = np.clip(theta + step, everything.lower, everything.upper) - theta
        bent = model.predict(theta + step, derivatives=False).coordinates - coordinates
        rows = residuals.rows(bent - jacobian @ step)
        # A draw without an equilibrium in some trial tells nothing.
        if np.isfinite(rows).all():
            squares.append(np.mean(rows**2))
    if not squares:
        return (
            "No draw from their priors has a prediction in every trial: the result may be far off."
        )
    return (
        "Drawn from their priors they bend predictions away from straight lines by "
        f"{np.sqrt(np.mean(squares)):.2g} standard deviations of noise and errors together (root "
        f"mean square of {len(squares)} draws)."
    )


def _tangent(setup: Identification, theta: Array) -> tuple[Array, Array]:
    """Coordinates at theta and their derivatives, shapes ``(n, 5)`` and ``(n, 5, p)``."""
    at = setup.model.predict(theta)
    if at.jacobian is None:  # pragma: no cover - it was asked for
        raise AssertionError
    return at.coordinates, at.jacobian
