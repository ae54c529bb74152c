"""One ensemble of walkers: where it starts, and how it goes on for a block of steps."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import emcee
import numpy as np
from emcee.moves import Move

from identknee.calibrate.evaluation import evaluate
from identknee.calibrate.fit import fit
from identknee.calibrate.scales import typical_steps
from identknee.identify.posterior.density import (
    LogPosterior,
    inside,
    newton_kernel,
    prior_draws,
)
from identknee.identify.posterior.moves import MOVES, surrogate_moves
from identknee.identify.posterior.surrogate import Surrogate
from identknee.identify.posterior.surrogate_training import trained
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.declare import declared

# Walkers start around an optimum with this many times the spread that its curvature promises; less
# only where too few of them would have a prediction.
OVERDISPERSION = (2.0, 1.0, 0.5, 0.25)
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
    """What one ensemble of a sample is asked to do, the same for all of its blocks.

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


def optimum_near_prior(task: Ensemble, number: int) -> Block:
    """Theta of the highest posterior density uphill from a draw of the prior; None without one.

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


def started(task: Ensemble, item: tuple[int, list[Array]]) -> Block:
    """The first state of an ensemble, its walkers spread widely around the optima.

    Every second walker starts around the optimum of the ensemble's own turn, the others around all
    in turn: ensembles begin apart, and each knows of every basin.

    Parameters
    ----------
    task
        What the ensemble is asked to do.
    item
        Number of the ensemble, and the optima, shape ``(n,)`` each.

    Returns
    -------
    block
        As of `advanced`, without steps; its positions are None where too few walkers found a
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


def learned(task: Ensemble, item: tuple[int, list[Array]]) -> Block:
    """The surrogate that an ensemble's trajectories will follow; None where it is of no use.

    Each ensemble learns its own, so that ensembles stay independent.

    Parameters
    ----------
    task
        What the ensemble is asked to do.
    item
        Number of the ensemble, and the optima, shape ``(n,)`` each.
    """
    number, optima = item
    parameters = task.density.parameters
    places = [_within(x, parameters) for x in optima]
    surrogate, n_simulations = trained(task.density, places, _generator(task.seed, 4, number))
    fields = None if surrogate is None else asdict(surrogate)
    return {"surrogate": fields, "n_simulations": n_simulations}


def advanced(task: Ensemble, item: tuple[int, int, Block, Block | None]) -> Block:
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
    state = emcee.State(
        np.asarray(before["positions"], dtype=np.float64),
        log_prob=np.asarray(before["log_density"], dtype=np.float64),
        blobs=blobs,
        # A block's random numbers follow from its place alone, so that nothing else need be kept.
        random_state=_random_state(task.seed, number, block),
    )
    n_walkers, n = state.coords.shape
    sampler = emcee.EnsembleSampler(
        n_walkers, n, walk, moves=_moves(task, surrogate), vectorize=True, blobs_dtype=np.float64
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


def _moves(task: Ensemble, surrogate: Block | None) -> list[tuple[Move, float]]:
    if surrogate is not None:
        return surrogate_moves(Surrogate(**surrogate))
    return MOVES["hamiltonian" if task.moves == "surrogate" else task.moves]()


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
            step = np.linalg.solve(factor.T, generator.standard_normal(n))
            point = optimum + spread * step
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


def _random_state(seed: int, number: int, block: int) -> Any:
    sequence = np.random.SeedSequence(seed, spawn_key=(2, number, block))
    return np.random.RandomState(np.random.MT19937(sequence)).get_state()
