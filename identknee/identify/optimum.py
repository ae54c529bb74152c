"""The best fit from which identifiability is analysed, the noise it leaves, its nuisances."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from identknee.calibrate.fit import Fit, FitSettings, fit, fit_many
from identknee.calibrate.problem import (
    RANK_TOLERANCE,
    Problem,
    WhitenedResiduals,
    evaluate,
    with_nuisance_priors,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array, IntArray, array, declared, entry
from identknee.runs.executors import Executor, serial
from identknee.runs.record import Outcome

N_STARTS = 16
# From points in groups of `N_STARTS` searches begin until `N_ALIKE` have ended at the lowest end: a
# lower one to which as many starts lead is missed once in 2^N_ALIKE. Verbs give MOST_STARTS points:
# one start in 32 leads to the lowest fits of the measured knee with bundles.
N_ALIKE, MOST_STARTS = 4, 64
# How many prior standard deviations around the subject's values the other starts lie in.
REACH = 2.0
# Of several brief fits the lowest that go on: where they end is not the order in which they began.
N_FINISHED = 4
# Misfit over that of noise beyond which a ligament may be torn, and what is left of its stiffness.
GROSS, NEARLY_GONE = 10.0, 0.02
# Logarithm of the largest factor by which a start differs from the point that it lies around.
FARTHEST_LOG = 20.0
# Searches of a round of hops, their reach in prior standard deviations round by round, the gain in
# deviance that counts, and how many rounds may gain nothing.
N_HOPS, REACH_OF_HOPS, A_GAIN, MOST_IDLE = 8, (1.0, 0.5, 1.0, 0.5, 1.0), 0.05, 2


def best_fit(
    problem: Problem, *, start: Array | None = None, seed: int = 0, executor: Executor = serial
) -> Fit:
    """The lowest of seventeen least-squares fits: one from `start`, sixteen from around it.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise.
    start
        Where the first fit begins and what the others lie around (Sobol points within two prior
        standard deviations), shape ``(n,)``; the subject's own values if None.
    seed
        Seed of the Sobol points' scrambling and of the fits.
    executor
        Anything with an ordered ``map``.

    Raises
    ------
    ValueError
        If the start lies outside the bounds, or no fit found a point with a prediction.
    """
    return best_fits(problem, start=start, seed=seed, executor=executor)[0]


def best_fits(
    problem: Problem,
    *,
    start: Array | None = None,
    seed: int = 0,
    executor: Executor = serial,
    budget: int | None = None,
    points: Array | None = None,
    hops: bool = True,
) -> tuple[Fit, ...]:
    """The seventeen fits that `best_fit` is the lowest of, from low to high; as there.

    With a budget each has so many simulations, and only the lowest few go on to their ends. Others
    begin at `points` in place of those around the start, shape ``(k, n)``, where these are given.
    Without `hops` those that follow brief searches are left to `with_hops`.
    """
    parameters = problem.parameters
    first = parameters.start if start is None else np.asarray(start, dtype=np.float64)
    check_within_bounds(first, parameters)
    begun = fit(problem, first, seed=seed, budget=budget)
    if points is None:
        points = sobol_around(parameters, first, N_STARTS, reach=REACH, seed=seed)
    fits = with_fits_from(problem, begun, points, executor=executor, budget=budget, hops=hops)
    if not np.isfinite(fits[0].objective):
        raise ValueError(
            f"the model has no prediction at any of {N_STARTS + 1} starts; "
            "see: identknee subject check"
        )
    return fits


def with_fits_from(
    problem: Problem,
    first: Fit,
    points: Array,
    *,
    executor: Executor = serial,
    budget: int | None = None,
    hops: bool = True,
) -> tuple[Fit, ...]:
    """A fit and those from other points, from low to high.

    The points are taken in groups of sixteen, until four searches have ended at the lowest end:
    then it is unlikely that a lower one was missed [1]_. With a budget the searches are brief, and
    hops follow, see `with_hops`. Where the lowest leaves many times what noise would, others begin
    with one stiffness nearly gone: no search finds its way to a torn ligament from a whole one.

    Parameters
    ----------
    problem
        That of the fit.
    first
        The fit. Its seed, its fixed parameters and its use of priors are theirs too.
    points
        Where the others begin, shape ``(k, n)``; what the fit holds is held at its value there.
    executor
        Anything with an ordered ``map``.
    budget
        Simulations allowed for each; only the lowest few go on to their ends. All do if None, and
        none hops.
    hops
        Whether hops follow brief searches.

    References
    ----------
    .. [1] C. G. E. Boender and A. H. G. Rinnooy Kan, Bayesian stopping rules for multistart global
           optimization methods, Math. Program. 37 (1987) 59-80, doi:10.1007/BF02591684.
    """
    seed, held = first.seed, [problem.parameters.index(x) for x in first.fixed]
    points = np.clip(points, problem.parameters.lower, problem.parameters.upper)
    points[:, held] = first.start[held]
    how: FitSettings = {"fixed": first.fixed, "priors": first.priors}
    brief: FitSettings = {"budget": budget, **how}
    fits = [first]
    for k in range(0, len(points), N_STARTS):
        group = points[k : k + N_STARTS]
        fits += fit_many(problem, group, seed=seed, executor=executor, **brief)
        fits.sort(key=lambda one: one.objective)
        if budget is not None:
            fits = _finished(problem, fits, N_FINISHED, how, executor)
        if sum(x.deviance < fits[0].deviance + A_GAIN for x in fits) >= N_ALIKE:
            break
    residuals = problem.residuals(fits[0].theta)
    # 1 if noise is all that is left.
    ratio = float(residuals @ residuals) / max(residuals.size - fits[0].theta.size, 1)
    if ratio > GROSS:
        gone = nearly_gone(problem.parameters, first.start, held)
        found = fit_many(problem, gone, seed=seed, executor=executor, **brief)
        fits = sorted([*fits, *found], key=lambda one: one.objective)
    if budget is None:
        return tuple(fits)
    fits = _finished(problem, fits, N_FINISHED, how, executor)
    if not hops:
        return tuple(fits)
    return with_hops(problem, fits, seed=seed, executor=executor, budget=budget)


def with_hops(
    problem: Problem,
    fits: Sequence[Fit],
    *,
    seed: int = 0,
    executor: Executor = serial,
    budget: int | None = None,
) -> tuple[Fit, ...]:
    """Fits and hops from the lowest of them, from low to high.

    Hops are searches from points near the lowest end, which keep its nuisances. They go on until
    two rounds of them find nothing lower [1]_, or half of many fits have ended at the lowest.

    References
    ----------
    .. [1] D. J. Wales and J. P. K. Doye, Global optimization by basin-hopping, J. Phys. Chem. A 101
           (1997) 5111-5116, doi:10.1021/jp970984n.
    """
    how: FitSettings = {"fixed": fits[0].fixed, "priors": fits[0].priors}
    brief: FitSettings = {"budget": budget, **how}
    held, known, idle = [problem.parameters.index(x) for x in fits[0].fixed], list(fits), 0
    for k, reach in enumerate(REACH_OF_HOPS):
        lowest = known[0]
        alike = sum(x.deviance < lowest.deviance + A_GAIN for x in known)
        if len(known) >= N_STARTS and 2 * alike > len(known):
            break
        near = sobol_around(problem.parameters, lowest.theta, N_HOPS, reach=reach, seed=seed + k)
        near[:, held] = lowest.theta[held]
        found = fit_many(problem, near, seed=seed + k, executor=executor, **brief)
        known = sorted([*known, *found], key=lambda one: one.objective)
        known = _finished(problem, known, 1, how, executor)
        idle = 0 if known[0].deviance < lowest.deviance - A_GAIN else idle + 1
        if idle == MOST_IDLE:
            break
    return tuple(known)


def nearly_gone(parameters: Parameters, start: Array, held: Sequence[int] = ()) -> Array:
    """The start with one stiffness nearly gone, each in turn that is not held, ``(k, n)``."""
    varied = parameters.is_log & parameters.is_of_interest
    varied[list(held)] = False
    places = np.flatnonzero(varied)
    points = np.tile(start, (places.size, 1))
    points[np.arange(places.size), places] *= NEARLY_GONE
    return np.clip(points, parameters.lower, parameters.upper)


def _finished(
    problem: Problem, fits: list[Fit], n: int, how: FitSettings, executor: Executor
) -> list[Fit]:
    """The fits, of which the lowest n go on to their ends, from low to high."""
    fits = list(fits)
    unfinished = [i for i, x in enumerate(fits[:n]) if x.outcome is Outcome.BUDGET]
    if not unfinished:
        return fits
    thetas = np.array([fits[i].theta for i in unfinished])
    ends = fit_many(problem, thetas, seed=fits[0].seed, executor=executor, **how)
    for i, end in zip(unfinished, ends, strict=True):
        spent = fits[i].n_simulations + end.n_simulations
        fits[i] = replace(end, start=fits[i].start, n_simulations=spent)
    return sorted(fits, key=lambda one: one.objective)


def check_within_bounds(theta: Array, parameters: Parameters) -> None:
    """Raise for a theta outside the bounds.

    Raises
    ------
    ValueError
        Naming the first parameter that is outside.
    """
    for name, value, low, high in zip(
        parameters.names, theta, parameters.lower, parameters.upper, strict=True
    ):
        if not low <= value <= high:
            raise ValueError(
                f"the start of {name} is {value:g}, outside its bounds {low:g} to {high:g}; "
                "start inside them or widen them with --bounds"
            )


def sobol_around(
    parameters: Parameters, center: Array, n: int, *, reach: float, seed: int
) -> Array:
    """Sobol points around a center, within the bounds, shape ``(n, p)``; nuisances stay there."""
    # Sobol points are balanced in powers of two only; the rest of such a set is left out.
    drawn = scipy.stats.qmc.Sobol(parameters.n, seed=seed).random_base2(int(np.ceil(np.log2(n))))[
        :n
    ]
    steps = reach * parameters.prior_sd * (2.0 * drawn - 1.0) * parameters.is_of_interest
    # A prior so wide that it says nothing reaches past all bounds.
    factors = np.exp(np.clip(steps, -FARTHEST_LOG, FARTHEST_LOG))
    points = np.where(parameters.is_log, center * factors, center + steps)
    return np.asarray(np.clip(points, parameters.lower, parameters.upper))


TOLERANCE = 1e-10
MAX_ROUNDS = 50
# Largest residual that cannot be distinguished from rounding.
SMALLEST_SD = 1e-9


@declared
class EstimatedNoise:
    """A problem with the noise estimated from its residuals."""

    problem: Problem = entry("The problem, its residuals in units of that noise")
    sds: Array = array("Standard deviation of each group, in the units of the data", "group")
    degrees_of_freedom: int = entry(
        "Residuals less parameters they determine: the denominator of an F threshold"
    )
    theta: Array = array("The best fit", "parameter")


def with_estimated_noise(problem: Problem, groups: IntArray, start: Array) -> EstimatedNoise:
    """The problem in units of its noise, estimated from the residuals of the best fit.

    The weighted fit and the standard deviations are repeated until neither changes. Each group's
    variance is its sum of squares over its own degrees of freedom: its residuals less its share of
    the fitted parameters, which is the trace of its block of the projection on the Jacobian.

    Parameters
    ----------
    problem
        Problem whose residuals are in the units of the data.
    groups
        The group of each residual, 0 to k - 1, shape ``(m,)``.
    start
        Where the fit begins, shape ``(n,)``.

    Raises
    ------
    ValueError
        If a group has no more residuals than the parameters it determines, if the fit leaves
        nothing to estimate a noise from, or if the model has no prediction at the start.

    References
    ----------
    H. D. Patterson and R. Thompson, Recovery of inter-block information when block sizes are
    unequal, Biometrika 58 (1971) 545-554, doi:10.1093/biomet/58.3.545.
    """
    sizes = np.bincount(groups)
    sds = np.ones(len(sizes))
    theta = np.asarray(start, dtype=np.float64)
    for _ in range(MAX_ROUNDS):
        scaled = with_nuisance_priors(WhitenedResiduals(problem=problem, sd=sds[groups]))
        best = fit(scaled, theta)
        if not np.isfinite(best.objective):
            raise ValueError(
                "the noise cannot be estimated because the model has no prediction at the start; "
                "start elsewhere with --start, or see: identknee subject check"
            )
        theta = best.theta
        # How many parameters each group determines, shape ``(k,)``. Rows of priors follow those of
        # the groups: what they determine the data do not.
        left, size, _ = np.linalg.svd(scaled.jacobian(theta), full_matrices=False)
        rank = int(np.sum(size > size[0] * RANK_TOLERANCE))
        leverage = np.sum(left[:, :rank] ** 2, axis=1)
        shares = np.bincount(groups, weights=leverage[: len(groups)]).astype(np.float64)

        degrees = sizes - shares
        if np.any(degrees < 1.0):
            raise ValueError(
                "there are too few measured values to estimate their noise beside the parameters; "
                "state it in the columns sd_<coordinate> or with --noise, for example "
                "--noise 0.5mm,0.5deg, measure more or fix parameters"
            )
        new = np.sqrt(np.bincount(groups, weights=problem.residuals(theta) ** 2) / degrees)
        if np.any(new < SMALLEST_SD):
            raise ValueError(
                "the model fits the data exactly, so there is no noise to estimate; state it in "
                "the columns sd_<coordinate> or with --noise, for example --noise 0.5mm,0.5deg"
            )

        settled = bool(np.all(np.abs(new - sds) <= TOLERANCE * new))
        sds = new
        if settled:
            break
    return EstimatedNoise(
        problem=with_nuisance_priors(WhitenedResiduals(problem=problem, sd=sds[groups])),
        sds=sds,
        degrees_of_freedom=round(float(sizes.sum() - shares.sum())),
        theta=theta,
    )


# Share of its prior variance that the data must take from a combination of nuisances to speak of
# it: what they hardly see has no scatter of its own.
LEAST_SEEN = 1e-6
OF_NUISANCE = "mm, deg or a plain number, as its name says"


@declared
class NuisanceEstimate:
    """A nuisance at the best fit."""

    name: str = entry("Name of the nuisance, whose last word is the unit")
    value: float = entry("Value at the best fit", unit=OF_NUISANCE)
    sd: float = entry(
        "Standard deviation that data and prior leave, to first order", unit=OF_NUISANCE
    )
    prior_sd: float = entry("Standard deviation of the prior", unit=OF_NUISANCE)
    center: float = entry("Middle of the prior", unit=OF_NUISANCE)

    @property
    def scatter(self) -> float:
        """Standard deviation of the estimate; near zero if the data hardly depend on it."""
        return float(np.sqrt(max(self.prior_sd**2 - self.sd**2, 0.0)))

    @property
    def away(self) -> float:
        """Distance from the prior mean in prior standard deviations."""
        return (self.value - self.center) / self.prior_sd


@declared
class NuisanceGroup:
    """Nuisances of one kind and place together."""

    name: str = entry("What they have in common, such as insertion.ACL_femur")
    n: int = entry("How many there are", unit="1")
    p_value: float = entry("Probability that errors with the stated prior lie so far out", unit="1")


def nuisance_estimates(problem: Problem, theta: Array) -> tuple[NuisanceEstimate, ...]:
    """The nuisances of a problem at its best fit, in the order of theta; empty without any."""
    p = problem.parameters
    places = np.flatnonzero(~p.is_of_interest)
    if not places.size:
        return ()
    sds = np.sqrt(np.diag(_covariance(problem, theta)))
    return tuple(
        NuisanceEstimate(
            name=p.names[i],
            value=float(theta[i]),
            sd=float(min(sds[i], p.prior_sd[i])),
            prior_sd=float(p.prior_sd[i]),
            center=float(p.center[i]),
        )
        for i in places
    )


def nuisance_groups(problem: Problem, theta: Array) -> tuple[NuisanceGroup, ...]:
    """How improbable the nuisances of each kind and place are under their prior.

    Estimates scatter by what the data have taken from the variance of the prior. Parameters as in
    `nuisance_estimates`.
    """
    p = problem.parameters
    covariance = _covariance(problem, theta)
    made = []
    for name, places in nuisance_places(p).items():
        sd = p.prior_sd[places]
        away = (theta[places] - p.center[places]) / sd
        scatter = np.eye(len(places)) - covariance[np.ix_(places, places)] / np.outer(sd, sd)
        size, directions = np.linalg.eigh(scatter)
        seen = size > LEAST_SEEN
        square = float(np.sum((directions[:, seen].T @ away) ** 2 / size[seen]))
        n = int(seen.sum())
        p_value = float(scipy.special.chdtrc(n, square)) if n else 1.0
        made.append(NuisanceGroup(name=name, n=len(places), p_value=p_value))
    return tuple(made)


def nuisance_places(parameters: Parameters) -> dict[str, list[int]]:
    """Places in theta of the nuisances of each kind and place, by the name of their group."""
    groups: dict[str, list[int]] = {}
    for i in np.flatnonzero(~parameters.is_of_interest).tolist():
        groups.setdefault(group_name(parameters.names[i]), []).append(i)
    return groups


def group_name(name: str) -> str:
    """Kind and place of a nuisance: its name without axis and unit.

    Examples
    --------
    >>> group_name("insertion.ACL_femur_x_mm"), group_name("load_axes.x_deg")
    ('insertion.ACL_femur', 'load_axes')
    """
    kind, _, rest = name.partition(".")
    words = rest.split("_")
    return f"{kind}.{'_'.join(words[:-2])}" if len(words) > 2 else kind


def _covariance(problem: Problem, theta: Array) -> Array:
    """First-order covariance of all parameters, without undetermined directions."""
    jacobian = evaluate(problem, theta).jacobian
    p = problem.parameters
    scaled = jacobian * p.prior_sd_in_own_units
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    return np.asarray(inverse * np.outer(p.prior_sd_in_own_units, p.prior_sd_in_own_units))
