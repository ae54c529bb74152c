"""The posterior by ensembles of walkers until they have converged, or by nested sampling."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import emcee
import numpy as np
from numpy.typing import ArrayLike

from identknee.calibrate.fit import fit
from identknee.calibrate.problem import Problem, evaluate, typical_steps
from identknee.identify.posterior.moves import MOVES, Surrogate, surrogate_moves, trained_surrogate
from identknee.identify.posterior.posterior import (
    QUANTILES,
    ConvergenceCheck,
    InfeasiblePriorMass,
    LogPosterior,
    Posterior,
    SampleOutcome,
    StopRule,
    check_convergence,
    expected_end,
    infeasible_prior_mass,
    inside,
    log_prior_working,
    newton_kernel,
    prior_draws,
    prior_quantiles,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import OF_PARAMETER, Array, array, declared, entry, frozen
from identknee.runs.executors import Executor, serial
from identknee.runs.progress import progress_bar
from identknee.runs.record import Record, record
from identknee.runs.schema import to_plain
from identknee.runs.store import Store, resumable_map

# Walkers start around an optimum with this many times the spread that its curvature predicts; less
# only where too few of them would have a prediction.
OVERDISPERSION = (2.0, 1.0, 0.5, 0.25, 0.1, 0.05, 0.02)
TRIES = 5
START_DRAWS = 20
# Simulations of the fit to a place to start from, for each parameter; most need a third of them. A
# fit that goes on creeps along a kink, and walkers spread as well from where it has come.
FIT_EACH = 12
# Share of a typical step: the logarithm of a bound and back may come out beyond it.
EDGE = 1e-9
Block = Mapping[str, Any]


@declared
class Ensemble:
    """The task of one ensemble, the same for all of its blocks.

    Attributes
    ----------
    density
        The posterior.
    n_walkers
        How many walkers it has.
    steps
        Steps of a block.
    moves
        A key of `identknee.identify.posterior.moves.MOVES`, or ``"surrogate"``.
    seed
        Seed of the sample.
    """

    density: LogPosterior
    n_walkers: int
    steps: int
    moves: str
    seed: int


def optimum_from_prior_draw(task: Ensemble, number: int) -> Block:
    """The posterior mode reached from a draw of the prior; None without a prediction.

    A least-squares fit from the first draw with a prediction; where that ends within `FIT_EACH`
    simulations a parameter, it is the mode in working coordinates.
    """
    generator = _generator(task.seed, 0, number)
    n_simulations = 0
    for start in prior_draws(task.density.parameters, START_DRAWS, generator):
        n_simulations += 1
        if evaluate(task.density.problem, start).is_finite:
            most = FIT_EACH * task.density.parameters.n
            best = fit(task.density.problem, start, priors=True, budget=most)
            n_simulations += best.n_simulations
            return {"theta": best.theta, "n_simulations": n_simulations}
    return {"theta": None, "n_simulations": n_simulations}


def initial_state(task: Ensemble, item: tuple[int, list[Array]]) -> Block:
    """The first state of an ensemble, its walkers spread widely around the optima.

    Every second walker starts around the optimum of the ensemble's own turn, the others around all
    in turn: ensembles begin apart, and each has walkers in every basin.

    Returns
    -------
    block
        As of `next_block`, without steps; its positions are None where too few walkers found a
        prediction.
    """
    number, optima = item
    parameters = task.density.parameters
    generator = _generator(task.seed, 1, number)
    walk = _Walk(task.density)
    rows: list[Array] = []
    for walker in range(task.n_walkers):
        own = number if walker % 2 == 0 else walker // 2
        row = _near(walk, _within(optima[own % len(optima)], parameters), generator)
        if row is None:
            return {"positions": None, "n_simulations": walk.n_simulations}
        rows.append(row)
    state = np.array(rows)
    n = parameters.n
    return {
        "positions": state[:, :n],
        "log_density": state[:, n],
        "blobs": state[:, n + 1 :],
        "n_simulations": walk.n_simulations,
    }


def train_surrogate(task: Ensemble, item: tuple[int, list[Array]]) -> Block:
    """The trained surrogate of an ensemble; None if it is not useful.

    Each ensemble learns its own, so that ensembles stay independent.
    """
    number, optima = item
    parameters = task.density.parameters
    places = [_within(x, parameters) for x in optima]
    surrogate, n_simulations = trained_surrogate(
        task.density, places, _generator(task.seed, 4, number)
    )
    fields = None if surrogate is None else asdict(surrogate)
    return {"surrogate": fields, "n_simulations": n_simulations}


def next_block(task: Ensemble, item: tuple[int, int, Block, Block | None]) -> Block:
    """The next block of steps of an ensemble.

    Parameters
    ----------
    task
        What the ensemble is asked to do.
    item
        Number of the ensemble, number of the block, the block before, and the fields of the
        ensemble's surrogate, None without one.

    Returns
    -------
    block
        ``positions`` in working coordinates, ``log_density`` and ``blobs`` of the walkers at its
        end; ``chain``, shape ``(walkers, steps, n)``, and ``chain_log_density`` of all its steps;
        ``n_simulations``.
    """
    number, block, before, surrogate = item
    walk = _Walk(task.density)
    blobs = np.asarray(before["blobs"], dtype=np.float64)
    sequence = np.random.SeedSequence(task.seed, spawn_key=(2, number, block))
    state = emcee.State(
        np.asarray(before["positions"], dtype=np.float64),
        log_prob=np.asarray(before["log_density"], dtype=np.float64),
        blobs=blobs,
        # A block's random numbers follow from its place alone, so that nothing else need be kept.
        random_state=np.random.RandomState(np.random.MT19937(sequence)).get_state(),
    )
    n_walkers, n = state.coords.shape
    sampler = emcee.EnsembleSampler(
        n_walkers,
        n,
        walk,
        moves=surrogate_moves(Surrogate(**surrogate))
        if surrogate is not None
        else MOVES["hamiltonian" if task.moves == "surrogate" else task.moves](),
        vectorize=True,
        blobs_dtype=np.float64,
    )
    # The sampler's own wrapper prints a traceback before it lets Ctrl-C through.
    sampler.log_prob_fn = walk
    end = sampler.run_mcmc(state, task.steps, skip_initial_state_check=True)
    return {
        "positions": end.coords,
        "log_density": end.log_prob,
        "blobs": end.blobs,
        "chain": sampler.get_chain().transpose(1, 0, 2),
        "chain_log_density": sampler.get_log_prob().T,
        "n_simulations": walk.n_simulations,
    }


class _Walk:
    """The density for emcee: each row is the log density, then the Newton kernel as a blob."""

    def __init__(self, density: LogPosterior) -> None:
        self._density = density
        self.n_simulations = 0

    def __call__(self, working: Array) -> Array:
        return np.array([self.row(point) for point in working], dtype=np.float64)

    def row(self, working: Array) -> Array:
        parameters = self._density.parameters
        theta = parameters.from_working(working)
        if not inside(theta, parameters):
            return _joined(-np.inf, np.zeros(parameters.n * (parameters.n + 1)))
        self.n_simulations += 1
        kernel = newton_kernel(evaluate(self._density.problem, theta), parameters)
        return _joined(kernel.log_density, kernel.center, kernel.factor)


def _near(walk: _Walk, optimum: Array, generator: np.random.Generator) -> Array | None:
    """A point around the optimum that has a prediction: its place, then its row; None if none."""
    n = len(optimum)
    row = walk.row(optimum)
    if not np.isfinite(row[0]):
        return None
    factor = row[n + 1 :].reshape(n, n)
    for spread in OVERDISPERSION:
        for _ in range(TRIES):
            point = optimum + spread * np.linalg.solve(factor.T, generator.standard_normal(n))
            row_there = walk.row(point)
            if np.isfinite(row_there[0]):
                return _joined(point, row_there)
    return None


def _within(optimum: Array, parameters: Parameters) -> Array:
    """The optimum in working coordinates; one at a bound is moved so far that it stays inside."""
    margin = EDGE * typical_steps(parameters)
    inner = np.clip(optimum, parameters.lower + margin, parameters.upper - margin)
    return parameters.to_working(inner)


def _joined(*parts: float | Array) -> Array:
    return np.concatenate([np.ravel(part) for part in parts]).astype(np.float64)


def _generator(seed: int, purpose: int, number: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose, number)))


STEPS = 10
PRIOR_CHUNK = 50
# Of 32 parameters (insertions uncertain by 2 mm) a tenth of all Newton proposals are accepted.
MOST_FOR_NEWTON = 12
# Trajectories need others for their mass alone, each of which knows all directions.
TRAJECTORIES = 12
# What reading a finished block takes at most [s].
KEPT_S = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Ensembles:
    """Number of ensembles and walkers, their moves and block lengths.

    Attributes
    ----------
    n_ensembles
        Independent ensembles, at least 4 for a sample that is to be trusted.
    n_walkers
        Walkers of each; twice the parameters, and at least 8, if None; 12 for trajectories.
    steps
        Steps between two checks.
    moves
        ``"newton"``, ``"hamiltonian"`` and ``"surrogate"`` use the exact Jacobian,
        ``"difference"`` (differential evolution and snooker) and ``"stretch"`` do without; Newton
        up to 12 parameters and a surrogate beyond if None. Where residuals are far from quadratic,
        Hamiltonian trajectories take the surrogate's place.
    n_prior
        Draws of the prior that are simulated to see how much of it has no prediction, a multiple
        of 50.
    """

    n_ensembles: int = 4
    n_walkers: int | None = None
    steps: int = STEPS
    moves: str | None = None
    n_prior: int = 400

    def __post_init__(self) -> None:
        if self.n_ensembles < 2:
            raise ValueError(
                f"at least 2 ensembles are needed to compare them, got {self.n_ensembles}"
            )
        if self.steps < 1:
            raise ValueError(f"a block needs at least 1 step, got {self.steps}")
        if self.n_prior < 0 or self.n_prior % PRIOR_CHUNK:
            raise ValueError(f"n_prior must be a multiple of {PRIOR_CHUNK}, got {self.n_prior}")
        if self.moves is not None and self.moves not in (*MOVES, "surrogate"):
            known = ", ".join(sorted((*MOVES, "surrogate")))
            raise ValueError(f"there are no moves {self.moves!r}; choose one of {known}")

    def moves_for(self, n: int) -> str:
        """The moves for so many parameters."""
        return self.moves or ("newton" if n <= MOST_FOR_NEWTON else "surrogate")

    def walkers_for(self, n: int) -> int:
        """Walkers of an ensemble for so many parameters.

        Raises
        ------
        ValueError
            If an odd number was asked for, or fewer than 8 or, but for trajectories, than twice
            the parameters.
        """
        has_trajectories = self.moves_for(n) in ("hamiltonian", "surrogate")
        fewest = 8 if has_trajectories else max(8, 2 * n)
        if self.n_walkers is None:
            return TRAJECTORIES if has_trajectories else fewest
        if self.n_walkers < fewest or self.n_walkers % 2:
            raise ValueError(
                f"{n} parameters need an even number of at least {fewest} walkers, "
                f"got {self.n_walkers}"
            )
        return self.n_walkers


def sample(
    problem: Problem,
    *,
    optima: ArrayLike | None = None,
    ensembles: Ensembles | None = None,
    rule: StopRule | None = None,
    seed: int = 0,
    executor: Executor = serial,
    store: Store | None = None,
) -> Posterior:
    """The posterior of a problem's parameters, sampled until all conditions of convergence are met.

    Independent ensembles of walkers start overdispersed around the optima and go on in blocks of
    steps. After each block one stop rule looks at all of them. Interrupted, the same call with the
    same store goes on and gives the same sample bit for bit, with any number of workers.

    Parameters
    ----------
    problem
        Its residuals in units of their noise; picklable if `executor` runs processes.
    optima
        Where to start: thetas of a basin map, shape ``(k, n)``. If None, the ends of one fit with
        priors for each ensemble, from draws of the prior.
    ensembles
        How many ensembles and walkers, and their moves.
    rule
        What the sample must reach, and the budget that ends it anyway.
    seed
        Seed of all random numbers.
    executor
        Anything with an ordered ``map``; ensembles are its tasks.
    store
        Where finished blocks are kept, from `identknee.runs.store.open_work`.

    Raises
    ------
    ValueError
        If the optima have the wrong shape or lie outside the bounds, or a setting is out of range.
        That the model has no prediction around them is not an error: the outcome says it.
    """
    ensembles, rule = ensembles or Ensembles(), rule or StopRule()
    density = LogPosterior(problem=problem)
    task = Ensemble(
        density=density,
        n_walkers=ensembles.walkers_for(density.parameters.n),
        steps=ensembles.steps,
        moves=ensembles.moves_for(density.parameters.n),
        seed=seed,
    )
    given = None
    if optima is not None:
        given = frozen(optima, None, density.parameters.n, name="optima")
        if not len(given):
            raise ValueError("there are no optima to start from; leave them out to find some")
        outside = np.flatnonzero(~inside(given, density.parameters))
        if outside.size:
            raise ValueError(
                f"optimum {int(outside[0])} lies outside the bounds or has no prior density: "
                f"{given[outside[0]].tolist()}"
            )
    run = _Run(task, ensembles.n_ensembles, executor, store)
    recording = record("sample", run.settings(rule), {}, seed)
    prior, excluded = run.prior(ensembles.n_prior)
    places = run.optima() if given is None else given
    is_begun = bool(len(places)) and run.begin(places)
    outcome = run.walk(rule) if is_begun else SampleOutcome.START_FAILED
    return Posterior(
        parameters=density.parameters,
        **run.arrays(),
        checks=tuple(run.checks),
        outcome=outcome,
        prior=prior,
        excluded=excluded,
        optima=places,
        n_simulations=run.n_simulations,
        n_walk_simulations=run.n_walk_simulations,
        seed=seed,
        record=recording.finish(),
    )


class _Run:
    """The running ensembles; every part of the work is a resumable map over them."""

    def __init__(
        self, task: Ensemble, n_ensembles: int, executor: Executor, store: Store | None
    ) -> None:
        self._task = task
        self._n_ensembles = n_ensembles
        self._executor = executor
        self._store = store
        self._states: list[Block] = []
        self._surrogates: list[Block | None] = [None] * n_ensembles
        shape = (n_ensembles, task.n_walkers, 0)
        self._chain = np.empty((*shape, task.density.parameters.n))
        self._log_density = np.empty(shape)
        self._moved = np.empty(shape, bool)
        self.checks: list[ConvergenceCheck] = []
        self.n_simulations = 0
        self.n_walk_simulations = 0

    def settings(self, rule: StopRule) -> dict[str, Any]:
        return {
            "n_ensembles": self._n_ensembles,
            "n_walkers": self._task.n_walkers,
            "moves": self._task.moves,
            "block_steps": self._task.steps,
            "rule": to_plain(rule),
        }

    def prior(self, n_draws: int) -> tuple[Array, InfeasiblePriorMass]:
        """Draws of the prior, and how many have no prediction."""
        density = self._task.density
        sequence = np.random.SeedSequence(self._task.seed, spawn_key=(3,))
        draws = prior_draws(density.parameters, n_draws, np.random.default_rng(sequence))
        chunks = list(draws.reshape(-1, PRIOR_CHUNK, density.parameters.n))
        parts = self._map(partial(_are_predicted, density), chunks, "prior")
        self.n_simulations += n_draws
        return draws, infeasible_prior_mass(density.parameters, np.array(parts, dtype=bool).ravel())

    def optima(self) -> Array:
        """Ends of one fit for each ensemble; none where no draw of the prior has a prediction."""
        numbers = list(range(self._n_ensembles))
        fits = self._map(partial(optimum_from_prior_draw, self._task), numbers, "optima")
        self.n_simulations += sum(x["n_simulations"] for x in fits)
        thetas = [x["theta"] for x in fits if x["theta"] is not None]
        return np.array(thetas, dtype=np.float64).reshape(-1, self._task.density.parameters.n)

    def begin(self, optima: Array) -> bool:
        """Whether all walkers of all ensembles found a place to start from."""
        items = [(number, list(optima)) for number in range(self._n_ensembles)]
        self._states = self._map(partial(initial_state, self._task), items, "start")
        self.n_simulations += sum(x["n_simulations"] for x in self._states)
        is_begun = all(x["positions"] is not None for x in self._states)
        if is_begun and self._task.moves == "surrogate":
            blocks = self._map(partial(train_surrogate, self._task), items, "surrogate")
            self.n_simulations += sum(x["n_simulations"] for x in blocks)
            self._surrogates = [x["surrogate"] for x in blocks]
        return is_begun

    def walk(self, rule: StopRule) -> SampleOutcome:
        with progress_bar("sampling", is_counted=False) as bar:
            while True:
                began = time.monotonic()
                block = len(self.checks)
                ways = zip(self._states, self._surrogates, strict=True)
                items = [(number, block, *way) for number, way in enumerate(ways)]
                states = self._map(partial(next_block, self._task), items, f"block {block:05d}")
                before = np.array([state["positions"] for state in self._states])
                chain = np.array([x["chain"] for x in states])
                path = np.concatenate([before[:, :, None], chain], axis=2)
                moved = np.any(np.diff(path, axis=2) != 0.0, axis=3)
                log_density = np.array([x["chain_log_density"] for x in states])
                self._chain = np.concatenate([self._chain, chain], axis=2)
                self._log_density = np.concatenate([self._log_density, log_density], axis=2)
                self._moved = np.concatenate([self._moved, moved], axis=2)
                self._states = states
                spent = sum(x["n_simulations"] for x in states)
                self.n_simulations += spent
                self.n_walk_simulations += spent
                latest = check_convergence(self._chain, self._moved, rule, self.checks)
                self.checks.append(latest)
                if latest.is_passed:
                    return SampleOutcome.CONVERGED
                if latest.stuck.any():
                    return SampleOutcome.STUCK
                if self.n_simulations >= rule.budget:
                    return SampleOutcome.BUDGET
                # Show how far sampling is, from the time that the last block took [s].
                block_s = time.monotonic() - began
                expected, words = expected_end(self.checks, self.n_simulations / rule.budget)
                steps = self.checks[-1].steps
                # A block that was kept takes no time.
                left_s = (
                    block_s / self._task.steps * (expected - steps) if block_s > KEPT_S else None
                )
                bar.to(steps / expected, words, left_s)

    def arrays(self) -> dict[str, Array]:
        parameters = self._task.density.parameters
        return {
            "samples": parameters.from_working(self._chain),
            "log_likelihood": self._log_density - log_prior_working(self._chain, parameters),
        }

    def _map(self, function: Any, items: Sequence[Any], name: str) -> list[Any]:
        return resumable_map(
            function,
            items,
            executor=self._executor,
            store=self._store,
            name=f"sample {name}",
            description=f"sampling, {name}",
        )


def _are_predicted(density: LogPosterior, thetas: Array) -> list[bool]:
    return [evaluate(density.problem, theta).is_finite for theta in thetas]


N_LIVE = 300
N_RESAMPLED = 100
# Log likelihood without a prediction; dynesty cannot compute with minus infinity.
IMPOSSIBLE = -1e300


@declared
class NestedPosterior:
    """Weighted draws of the posterior by nested sampling, and the evidence."""

    parameters: Parameters = entry("The parameters, in the order of theta")
    samples: Array = array("Theta", "draw", "parameter", unit=OF_PARAMETER)
    weights: Array = array("Posterior weight of each draw; the sum is 1", "draw")
    quantile_errors: Array = array(
        "Standard errors of the 2.5, 50 and 97.5 % quantiles, from runs resampled from the live "
        "points of this one",
        *("parameter", "quantile"),
        unit=OF_PARAMETER,
    )
    log_evidence: float = entry(
        "Logarithm of the mean likelihood over the prior within the bounds, the likelihood being "
        "``exp(-deviance / 2)``: without the constant that depends on the noise alone",
        unit="1",
    )
    log_evidence_error: float = entry("Its standard error", unit="1")
    n_simulations: int = entry("How many it took", unit="1")
    seed: int = entry("Seed of all random numbers")
    record: Record = entry("The call, its settings and the time")

    @property
    def effective_draws(self) -> float:
        """Effective sample size of weighted draws (Kish)."""
        return float(1.0 / np.sum(self.weights**2))

    def quantiles(self, probabilities: ArrayLike = QUANTILES) -> Array:
        """Posterior quantiles of each parameter, shape ``(n, k)``."""
        return np.array(
            [weighted_quantiles(x, self.weights, probabilities) for x in self.samples.T]
        )


def weighted_quantiles(values: Array, weights: Array, probabilities: ArrayLike) -> Array:
    """Quantiles of weighted values, both of shape ``(k,)``, between them linear.

    Examples
    --------
    >>> weighted_quantiles(np.array([3.0, 1.0, 2.0]), np.array([0.2, 0.4, 0.4]), [0.5])
    array([1.75])
    """
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    return np.asarray(np.interp(np.asarray(probabilities), below, values[order]))


def nested_posterior(problem: Problem, *, n_live: int = N_LIVE, seed: int = 0) -> NestedPosterior:
    """The posterior and the evidence by nested sampling with dynesty.

    It shares the density with `identknee.identify.posterior.sample.sample` and nothing else: no
    starts, no derivatives, no chains. It is a check, slower and not resumable.

    Parameters
    ----------
    problem
        Problem whose residuals are in units of their noise.
    n_live
        Live points; errors shrink with their square root, time grows with them.
    seed
        Seed of all random numbers.

    Raises
    ------
    ModuleNotFoundError
        If dynesty is not installed.
    ValueError
        If there are fewer than two live points a parameter.

    References
    ----------
    J. S. Speagle, dynesty: a dynamic nested sampling package for estimating Bayesian posteriors
    and evidences, MNRAS 493 (2020) 3132-3158, doi:10.1093/mnras/staa278.
    """
    parameters = LogPosterior(problem=problem).parameters
    if n_live < 2 * parameters.n:
        raise ValueError(
            f"nested sampling of {parameters.n} parameters needs at least {2 * parameters.n} live "
            f"points, got {n_live}"
        )
    try:
        import dynesty
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            'nested sampling needs the package dynesty; install it with: pip install "identknee'
            '[nested]"'
        ) from error
    recording = record("nested", {"n_live": n_live}, {}, seed)

    def log_likelihood(theta: Array) -> float:
        evaluation = evaluate(problem, theta)
        return -0.5 * evaluation.deviance if evaluation.is_finite else IMPOSSIBLE

    sampler = dynesty.NestedSampler(
        log_likelihood,
        lambda unit: prior_quantiles(parameters, np.asarray(unit)),
        parameters.n,
        nlive=n_live,
        # Uniform draws within ellipsoids waste most of their simulations on a curved ridge.
        sample="rwalk",
        rstate=np.random.default_rng(seed),
    )
    sampler.run_nested(print_progress=False)
    results = sampler.results
    # Spread of the quantiles over runs with other live points and other prior volumes. The number
    # of effective draws would not do: live points share ancestors, and how much of the prior each
    # one stands for is itself an estimate.

    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    rows = []
    for _ in range(N_RESAMPLED):
        run = dynesty.utils.resample_run(results, rstate=generator)
        run = dynesty.utils.jitter_run(run, rstate=generator)
        columns = np.asarray(run.samples).T
        rows.append([weighted_quantiles(x, _weights(run), QUANTILES) for x in columns])
    return NestedPosterior(
        parameters=parameters,
        samples=np.asarray(results.samples),
        weights=_weights(results),
        quantile_errors=np.asarray(np.std(rows, axis=0, ddof=1)),
        log_evidence=float(results.logz[-1]),
        log_evidence_error=float(results.logzerr[-1]),
        n_simulations=int(np.sum(results.ncall)),
        seed=seed,
        record=recording.finish(),
    )


def quantile_differences(posterior: Posterior, nested: NestedPosterior) -> Array:
    """Differences of the 2.5, 50 and 97.5 % quantiles in their joint standard error, ``(n, 3)``."""
    difference = posterior.quantiles() - nested.quantiles()
    error = np.hypot(posterior.quantile_errors(), nested.quantile_errors)
    return np.asarray(difference / error)


def _weights(results: Any) -> Array:
    weights = np.exp(results.logwt - np.max(results.logwt))
    return np.asarray(weights / np.sum(weights), dtype=np.float64)
