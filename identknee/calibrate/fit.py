"""One verb for all optimizers: a problem and a start in, a fitted parameter set out."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from identknee.calibrate.complex import minimise_by_complex
from identknee.calibrate.evaluation import Evaluator, SearchEnded
from identknee.calibrate.least_squares import gauss_newton, minimise_by_least_squares
from identknee.calibrate.population import (
    minimise_by_annealing,
    minimise_by_cma_es,
    minimise_by_genetic,
    minimise_by_particle_swarm,
)
from identknee.calibrate.problem import Problem, restricted, with_all_priors
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array, frozen
from identknee.runs.declare import OF_PARAMETER, array, declared, entry
from identknee.runs.executors import Executor, serial, spawn_seeds
from identknee.runs.progress import progress, progress_bar
from identknee.runs.record import Outcome

BUDGET = 2500

Method = Callable[[Evaluator, Array, np.random.Generator], Outcome]

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "least-squares": minimise_by_least_squares,
        "complex": minimise_by_complex,
        "genetic": minimise_by_genetic,
        "particle-swarm": minimise_by_particle_swarm,
        "cma-es": minimise_by_cma_es,
        "annealing": minimise_by_annealing,
    }
)


class FitSettings(TypedDict, total=False):
    """Options that `fit_many` passes on to each `fit`, under the same names."""

    method: str
    budget: int | None
    fixed: Sequence[str]
    priors: bool


@declared
class Fit:
    """Where an optimizer ended, and how."""

    method: str = entry("Name of the optimizer")
    parameters: Parameters = entry("All parameters of the problem, fixed ones included")
    fixed: tuple[str, ...] = entry("Names of those held at their start")
    priors: bool = entry("Whether the priors were part of the objective")
    start: Array = array("Theta where the search began", "parameter", unit=OF_PARAMETER)
    theta: Array = array(
        "Best theta seen; the start where no simulation had a prediction",
        "parameter",
        unit=OF_PARAMETER,
    )
    objective: float = entry(
        "Half the sum of squares at `theta`, with the priors' where they were used; null where no "
        "simulation had a prediction",
        unit="mm2 and deg2 with unit weighting, else 1",
    )
    outcome: Outcome = entry("How the search ended")
    message: str = entry("How the search ended, as a sentence", key="sentence")
    n_simulations: int = entry("Simulations made", unit="1")
    budget: int = entry("Simulations allowed", unit="1")
    seconds: float = entry("Time taken by the search", unit="s")
    seed: int = entry("Seed of the random numbers")
    history: Array = array(
        "Simulation number and best objective so far, at each improvement", "improvement", "member"
    )
    gradient_norm: float | None = entry(
        "Largest derivative of the objective at `theta` by a free parameter, times its typical "
        "step (3 kN, 2 %), leaving out those that only lead out of the bounds; null where the "
        "model has no derivatives",
        unit="unit of the objective",
    )

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Names of the parameters that ended on one of their bounds."""
        low, high = self.theta <= self.parameters.lower, self.theta >= self.parameters.upper
        return tuple(np.array(self.parameters.names)[low | high].tolist())

    @property
    def deviance(self) -> float:
        """Sum of squares at `theta`: twice the objective."""
        return 2.0 * self.objective

    @override
    def __str__(self) -> str:
        """A short table: start and end of each parameter, and how it ended."""
        width = max(len(name) for name in self.parameters.names)
        rows = [
            f"{name:<{width}} {start:12.6g} {end:12.6g}"
            for name, start, end in zip(self.parameters.names, self.start, self.theta, strict=True)
        ]
        head = f"{self.method:<{width}} {'start':>12} {'end':>12}"
        return "\n".join([head, *rows, f"objective {self.objective:.6g}. {self.message}"])


def fit(
    problem: Problem,
    start: ArrayLike,
    *,
    method: str = "least-squares",
    seed: int = 0,
    budget: int | None = None,
    fixed: Sequence[str] = (),
    priors: bool = False,
) -> Fit:
    """The parameter set that an optimizer finds from one start.

    Parameters
    ----------
    problem
        What to fit.
    start
        Theta to begin at, shape ``(n,)``; the centre of the box of first candidates for all
        methods but least squares.
    method
        ``"least-squares"``, ``"complex"``, ``"genetic"``, ``"particle-swarm"``, ``"cma-es"`` or
        ``"annealing"``. The same seed gives the same fit.
    seed
        Seed of the random numbers, not negative.
    budget
        Simulations allowed; 2,500 if None.
    fixed
        Names of parameters to hold at their start.
    priors
        Whether to add the parameters' priors to the residuals.

    Raises
    ------
    ValueError
        If the start has another length or is not finite, or the method, a fixed name, the seed or
        the budget is not one of those possible. That the model has no prediction is not an error:
        the outcome says it.
    ModuleNotFoundError
        If the method needs a package that is not installed.
    """
    allowed = BUDGET if budget is None else budget
    with progress_bar(f"fitting by {method}", allowed) as advance:
        return _fit(
            problem,
            (start, seed),
            method=method,
            budget=budget,
            fixed=fixed,
            priors=priors,
            on_simulation=advance,
        )


def fit_many(
    problem: Problem,
    starts: ArrayLike,
    *,
    seed: int = 0,
    executor: Executor = serial,
    **settings: Unpack[FitSettings],
) -> tuple[Fit, ...]:
    """One fit from each start, in their order, failed ones included.

    Parameters
    ----------
    problem
        What to fit; it must be picklable if `executor` runs processes.
    starts
        Where to begin, shape ``(n_starts, n)``.
    seed
        Each fit gets a seed of its own from this one; it stands in the fit and repeats it alone.
    executor
        Anything with an ordered ``map``; the fits are the same whichever it is.
    settings
        `method`, `budget`, `fixed` and `priors` as for `fit`.

    Raises
    ------
    ValueError, ModuleNotFoundError
        As in `fit`.
    """
    points = frozen(starts, None, problem.parameters.n, name="starts")
    seeds = [int(child.generate_state(1)[0]) for child in spawn_seeds(seed, len(points))]
    tasks = list(zip(points, seeds, strict=True))
    fits = executor.map(partial(_fit, problem, **settings), tasks)
    return tuple(progress(fits, total=len(tasks), description="fitting"))


def waterfall(fits: Sequence[Fit]) -> Array:
    """The objectives of the fits from low to high, shape ``(n_fits,)``; inf for failed ones."""
    return np.sort([fit.objective for fit in fits])


def _fit(
    problem: Problem,
    task: tuple[ArrayLike, int],
    *,
    method: str = "least-squares",
    budget: int | None = None,
    fixed: Sequence[str] = (),
    priors: bool = False,
    on_simulation: Callable[[int], None] | None = None,
) -> Fit:
    parameters, seed = problem.parameters, task[1]
    start = _checked_start(task[0], parameters)
    if method not in METHODS:
        raise ValueError(f"there is no method {method!r}; the methods are {', '.join(METHODS)}")
    minimise = METHODS[method]
    allowed = _checked_budget(budget)
    if seed < 0:
        raise ValueError(f"the seed must not be negative, got {seed}")
    generator = np.random.default_rng(seed)
    whole = with_all_priors(problem) if priors else problem
    part = restricted(whole, fixed, start)
    evaluator = Evaluator(part, budget=allowed, on_simulation=on_simulation)
    began = time.perf_counter()
    try:
        outcome = minimise(evaluator, part.free.restrict(start), generator)
    except SearchEnded as end:
        outcome = end.outcome
    if evaluator.best_theta is None:
        outcome = Outcome.START_FAILED
    return Fit(
        method=method,
        parameters=parameters,
        fixed=tuple(fixed),
        priors=priors,
        start=start,
        theta=start if evaluator.best_theta is None else part.free.expand(evaluator.best_theta),
        objective=0.5 * evaluator.best_deviance,
        outcome=outcome,
        message=_message(outcome, evaluator),
        n_simulations=evaluator.n_simulations,
        budget=allowed,
        gradient_norm=_gradient_norm(evaluator),
        seconds=time.perf_counter() - began,
        seed=seed,
        history=np.array(evaluator.history).reshape(-1, 2) * [1.0, 0.5],
    )


def _message(outcome: Outcome, evaluator: Evaluator) -> str:
    n = evaluator.n_simulations
    simulations = "1 simulation" if n == 1 else f"{n} simulations"
    if outcome is Outcome.START_FAILED and n > 1:
        return f"The model has no prediction at any of {simulations} around the start."
    return f"{outcome.sentence} It took {simulations}."


def _gradient_norm(evaluator: Evaluator) -> float | None:
    """Norm of the gradient; not counted, because theta was simulated already."""
    if evaluator.best_theta is None:
        return None
    here = evaluator(evaluator.best_theta)
    if not here.is_finite:
        return None
    # A search without bounds may end outside them, where they do not hold it back.
    return 0.5 * gauss_newton(here, evaluator.parameters).gradient_norm


def _checked_start(start: ArrayLike, parameters: Parameters) -> Array:
    checked = frozen(start, parameters.n, name="the start")
    for name, value in zip(parameters.names, checked, strict=True):
        if not np.isfinite(value):
            raise ValueError(f"the start of {name} must be a finite number, got {value}")
    return checked


def _checked_budget(budget: int | None) -> int:
    if budget is None:
        return BUDGET
    if budget < 1:
        raise ValueError(f"the budget must be at least 1 simulation, got {budget}")
    return budget
