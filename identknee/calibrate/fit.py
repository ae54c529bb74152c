"""Fits of a problem from a start by any of the optimizers.

Also starts by name or from a file, and a fit with Student's t errors.
"""

import os
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, RootModel
from typing_extensions import override

from identknee.calibrate.least_squares import gauss_newton, minimise_by_least_squares
from identknee.calibrate.population import (
    minimise_by_annealing,
    minimise_by_cma_es,
    minimise_by_complex,
    minimise_by_genetic,
    minimise_by_particle_swarm,
)
from identknee.calibrate.problem import (
    RANK_TOLERANCE,
    Evaluator,
    Problem,
    SearchEnded,
    WhitenedResiduals,
    restricted,
    with_all_priors,
    with_nuisance_priors,
    without_priors,
)
from identknee.model.parameters import Parameters
from identknee.runs.declare import OF_PARAMETER, Array, IntArray, array, declared, entry, frozen
from identknee.runs.errors import InputError, closest, suggestion
from identknee.runs.executors import Executor, serial, spawn_seeds
from identknee.runs.progress import progress, progress_bar
from identknee.runs.record import Outcome
from identknee.runs.schema import Fault, number, read_toml, validated
from identknee.runs.words import unit_of

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
    """The result of an optimizer: the fitted parameters and how the search ended."""

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
        Theta to begin at, shape ``(n,)``. All methods but least squares begin with candidates from
        a box around it.
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
        Each fit gets a seed of its own from this one, which it records and which repeats it alone.
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
    start = frozen(task[0], parameters.n, name="the start")
    for name, value in zip(parameters.names, start, strict=True):
        if not np.isfinite(value):
            raise ValueError(f"the start of {name} must be a finite number, got {value}")
    if method not in METHODS:
        raise ValueError(f"there is no method {method!r}; the methods are {', '.join(METHODS)}")
    minimise = METHODS[method]
    allowed = BUDGET if budget is None else budget
    if allowed < 1:
        raise ValueError(f"the budget must be at least 1 simulation, got {budget}")
    if seed < 0:
        raise ValueError(f"the seed must not be negative, got {seed}")
    generator = np.random.default_rng(seed)
    part = restricted(with_all_priors(problem) if priors else problem, fixed, start)
    evaluator = Evaluator(part, budget=allowed, on_simulation=on_simulation)
    began = time.perf_counter()
    try:
        outcome = minimise(evaluator, part.free.restrict(start), generator)
    except SearchEnded as end:
        outcome = end.outcome
    if evaluator.best_theta is None:
        outcome = Outcome.START_FAILED
    n = evaluator.n_simulations
    simulations = "1 simulation" if n == 1 else f"{n} simulations"
    message = f"{outcome.sentence} It took {simulations}."
    if outcome is Outcome.START_FAILED and n > 1:
        message = f"The model has no prediction at any of {simulations} around the start."
    gradient_norm = None
    # The evaluator remembers the best theta, so that this is no further simulation.
    here = None if evaluator.best_theta is None else evaluator(evaluator.best_theta)
    if here is not None and here.is_finite:
        # A search without bounds may end outside them, where they do not hold it back.
        gradient_norm = 0.5 * gauss_newton(here, evaluator.parameters).gradient_norm
    return Fit(
        method=method,
        parameters=parameters,
        fixed=tuple(fixed),
        priors=priors,
        start=start,
        theta=start if evaluator.best_theta is None else part.free.expand(evaluator.best_theta),
        objective=0.5 * evaluator.best_deviance,
        outcome=outcome,
        message=message,
        n_simulations=evaluator.n_simulations,
        budget=allowed,
        gradient_norm=gradient_norm,
        seconds=time.perf_counter() - began,
        seed=seed,
        history=np.array(evaluator.history).reshape(-1, 2) * [1.0, 0.5],
    )


SUBJECT = "subject"
# Stands for the name of a start that was given as values.
IN_MEMORY = "the values of start"
FILE_LIMIT_MB = 1


def start_names() -> tuple[str, ...]:
    """Names that `named_start` knows.

    Examples
    --------
    >>> start_names()
    ('subject', 'IG1', 'IG2', 'IG3', 'IG4')
    """
    return (SUBJECT, *_published())


# A start: its name, the path of a file, or values by parameter.
StartLike = str | os.PathLike[str] | Mapping[str, Any]


def load_start(name_or_path: StartLike, parameters: Parameters) -> Array:
    """Theta of a named start, of a file whose path ends in ``.toml``, or of values, ``(n,)``.

    Values are those of parameters by name, or of ligaments with a dictionary each, as such a file
    and ``result.json`` have them; parameters without one keep the subject's value.

    Raises
    ------
    ValueError
        As in `named_start`; `InputError` as in `read_start`.
    """
    if isinstance(name_or_path, Mapping):
        return _checked_start(Path(IN_MEMORY), dict(_flat(name_or_path)), parameters)
    if Path(name_or_path).suffix.lower() == ".toml":
        return read_start(name_or_path, parameters)
    return named_start(os.fspath(name_or_path), parameters)


def named_start(name: str, parameters: Parameters) -> Array:
    """Theta of a named start, shape ``(n,)``.

    Parameters
    ----------
    name
        ``"subject"`` for the subject's own values, or ``"IG1"`` to ``"IG4"`` for the initial
        guesses of the paper (Table 1), which speak of an ACL, PCL, LCL and MCL. All other
        parameters keep the subject's values.
    parameters
        The parameters of the model.

    Raises
    ------
    ValueError
        If there is no such start, or the model lacks a parameter the start speaks of.
    """
    if name == SUBJECT:
        return parameters.start
    published = _published()
    if name not in published:
        close = closest(name, start_names())
        raise ValueError(
            f"there is no start {name!r}; {f'did you mean {close}? T' if close else 't'}he starts "
            f"are {', '.join(start_names())} or the path of a file ending in .toml"
        )
    values = dict(_flat(published[name]))
    missing = [parameter for parameter in values if parameter not in parameters.names]
    if missing:
        owner = parameters.names[0].rpartition(".")[0]
        lacking = list(dict.fromkeys(parameter.rpartition(".")[0] for parameter in missing))
        raise ValueError(
            f"the start {name} speaks of {', '.join(lacking)}, which this knee does not have; "
            "write a start of your own as a TOML file, such as\n"
            f"[{owner}]\nstiffness_kN = 9.5\nreference_strain_pct = 7.5"
        )
    return frozen(parameters.vector(values), parameters.n, name="the start")


def read_start(path: str | os.PathLike[str], parameters: Parameters) -> Array:
    """Theta from a TOML file, shape ``(n,)``; omitted parameters keep the subject's value.

    The file has a table for each ligament, such as::

        [ACL]
        stiffness_kN = 9.5
        reference_strain_pct = 7.5

    Raises
    ------
    InputError
        If the file cannot be read, or has a name that is no parameter's, or a value that is not a
        number within the parameter's bounds.
    """
    file = Path(path)
    return _checked_start(file, dict(_flat(read_toml(file, FILE_LIMIT_MB))), parameters)


def start_word(start: StartLike) -> str:
    """What a result calls a start."""
    return IN_MEMORY if isinstance(start, Mapping) else os.fspath(start)


def _checked_start(file: Path, values: Mapping[str, Any], parameters: Parameters) -> Array:
    """Theta of these values, the subject's for the rest; `file` is what messages name."""
    for name in values:
        if name not in parameters.names:
            raise InputError(
                file, name[:100], "there is no such parameter", suggestion(name, parameters.names)
            )
    start = validated(StartValues, values, lambda fault: _wrong(file, fault, parameters)).root
    for name, value in start.items():
        i = parameters.index(name)
        if not parameters.lower[i] <= value <= parameters.upper[i]:
            why = f"{_sized(value, name)} is out of bounds"
            raise InputError(file, name, why, _allowed(name, parameters))
    return frozen(parameters.vector(start), parameters.n, name="the start")


class StartValues(RootModel[dict[str, Annotated[float, number("{} is not a finite number")]]]):
    """The values of a file of starts by the parameter's name."""

    model_config = ConfigDict(strict=True)


def _wrong(file: Path, fault: Fault, parameters: Parameters) -> InputError:
    name = str(fault.place[0])
    return InputError(file, name, fault.why, _allowed(name, parameters))


def _allowed(name: str, parameters: Parameters) -> str:
    i = parameters.index(name)
    return f"Give a number from {parameters.lower[i]:g} to {_sized(parameters.upper[i], name)}."


def _sized(value: float, name: str) -> str:
    """A value of a parameter as a file of starts would have it, with the unit it is in."""
    return f"{value:g} {unit_of(name)}".rstrip()


def _published() -> dict[str, Any]:
    text = resources.files("identknee.calibrate").joinpath("starts.toml").read_text("utf-8")
    return tomllib.loads(text)


def _flat(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    # No recursion: a dotted key in a file may be nested deeper than Python's limit.
    waiting = [*table.items()][::-1]
    while waiting:
        name, value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [(f"{name}.{key}", x) for key, x in [*value.items()][::-1]]
        else:
            yield name, value


# Degrees of freedom of Student's t: one gross error in twenty values hardly moves the fit.
DEGREES = 4.0
MOST_FITS = 20
ROUNDS = 50
SETTLED = 1e-3
SMALLEST = 1e-9


def fit_student(
    problem: Problem, units: IntArray, start: Array, search: Callable[[Problem, Array], Fit]
) -> Fit:
    """The maximum-likelihood fit for Student's t errors of unknown scale.

    The fit is repeated with each value weighted by its last residual, until no scale changes by
    more than a thousandth [1]_. Nuisances keep their priors.

    Parameters
    ----------
    problem
        The problem. Its residuals may be unweighted or in units of their noise.
    units
        Which of two scales belongs to each residual of the data: 0 for mm, 1 for deg, ``(m,)``.
    start
        Theta where the first fit begins, shape ``(n,)``.
    search
        Fits a problem from a start.

    Returns
    -------
    fit
        The last fit, with the number of simulations of all fits. Its objective is in units of the
        scales.

    References
    ----------
    .. [1] Lange, Little and Taylor (1989), J. Am. Stat. Assoc. 84(408), 881-896.
           https://doi.org/10.1080/01621459.1989.10478852
    """
    data, begun = without_priors(problem), np.array(start)
    found = search(problem, begun)
    n_simulations = found.n_simulations
    scales = np.zeros(2)
    for _ in range(MOST_FITS):
        if not np.isfinite(found.objective) or n_simulations >= found.budget:
            break
        before = scales
        scales, weights = student_scales(data, units, found.theta)
        if np.all(np.abs(scales - before) <= SETTLED * scales):
            break
        scaled = WhitenedResiduals(problem=data, sd=scales[units] / np.sqrt(weights))
        found = search(with_nuisance_priors(scaled), found.theta)
        n_simulations += found.n_simulations
    return replace(found, start=begun, n_simulations=n_simulations)


def student_scales(data: Problem, units: IntArray, theta: Array) -> tuple[Array, Array]:
    """The scale of the errors in each unit (2,), and the weight of each value (m,).

    The square of a scale is the sum of the weighted squared residuals over their degrees of
    freedom; it is 1 where no value has that unit.
    """
    residuals, is_there = data.residuals(theta), np.bincount(units, minlength=2) > 0
    scales, weights = np.ones(2), np.ones(units.size)
    for _ in range(ROUNDS):
        before = scales
        scaled = WhitenedResiduals(problem=data, sd=scales[units] / np.sqrt(weights))
        # Residual degrees of freedom of the values of each unit, at least 1.
        left, size, _ = np.linalg.svd(
            with_nuisance_priors(scaled).jacobian(theta), full_matrices=False
        )
        leverage = np.sum(left[: units.size, size > size[0] * RANK_TOLERANCE] ** 2, axis=1)
        degrees = np.maximum(np.bincount(units, weights=1.0 - leverage, minlength=2), 1.0)
        squares = np.bincount(units, weights=weights * residuals**2, minlength=2)
        scales = np.where(is_there, np.maximum(np.sqrt(squares / degrees), SMALLEST), 1.0)
        weights = (DEGREES + 1.0) / (DEGREES + (residuals / scales[units]) ** 2)
        if np.all(np.abs(scales - before) <= SETTLED * scales):
            break
    return scales, weights
