"""Ask-and-tell searches with a population: the paper's Complex method, and others from libraries.

They begin in the paper's box around the start and stay within the parameters' bounds. To all of
them an infinite deviance is only worse than any other.
"""

import importlib
from typing import Any, Protocol

import numpy as np

from identknee.calibrate.problem import Evaluator, floors, half_widths
from identknee.model.parameters import Parameters
from identknee.runs.declare import Array
from identknee.runs.record import Outcome

POPULATION = 20
SPREAD_TOLERANCE = 1e-3


class AskTellSearch(Protocol):
    """An ask-and-tell search."""

    @property
    def population(self) -> Array:
        """The current candidates, shape ``(k, n)``."""

    def ask(self) -> Array:
        """Candidates to evaluate, shape ``(m, n)``; none if there is no new one."""

    def tell(self, values: Array) -> None:
        """Take the deviances of the candidates just asked, shape ``(m,)``; they may be inf."""


def run_search(search: AskTellSearch, evaluator: Evaluator) -> Outcome:
    """How the search ended: when the population's spread in every parameter was below 1e-3.

    The spread is the largest minus the smallest value, in the unit of the parameter (kN or %).

    Raises
    ------
    SearchEnded
        If the budget of the evaluator was used up first.
    """
    while True:
        candidates = search.ask()
        if len(candidates) == 0:
            return Outcome.SPREAD
        search.tell(np.array([evaluator.deviance(candidate) for candidate in candidates]))
        if np.all(np.ptp(search.population, axis=0) < SPREAD_TOLERANCE):
            return Outcome.SPREAD


def uniform_box(generator: np.random.Generator, n: int, low: Array, high: Array) -> Array:
    """Points drawn uniformly from a box, shape ``(n, len(low))``."""
    return generator.uniform(low, high, size=(n, len(low)))


# Deviance in place of infinity for libraries that compute differences of deviances.
NO_PREDICTION = 1e100
# scipy's default of 5,230 makes jumps across the whole box: with it, 2,500 simulations of eight
# springs (tests/support/problems.py) from a start near the minimum never went below the start.
INITIAL_TEMPERATURE = 10.0


def minimise_by_genetic(
    evaluator: Evaluator, start: Array, generator: np.random.Generator
) -> Outcome:
    """How pymoo's genetic algorithm with 20 members ended."""
    module = _imported("pymoo.algorithms.soo.nonconvex.ga")
    return run_search(PymooSearch(module.GA, evaluator.parameters, start, generator), evaluator)


def minimise_by_particle_swarm(
    evaluator: Evaluator, start: Array, generator: np.random.Generator
) -> Outcome:
    """How pymoo's adaptive particle swarm with 20 particles ended."""
    module = _imported("pymoo.algorithms.soo.nonconvex.pso")
    search = PymooSearch(module.PSO, evaluator.parameters, start, generator)
    return run_search(search, evaluator)


def minimise_by_cma_es(
    evaluator: Evaluator, start: Array, generator: np.random.Generator
) -> Outcome:
    """How CMA-ES ended; its initial normal has the variance of the uniform box."""
    return run_search(CmaSearch(evaluator.parameters, start, generator), evaluator)


def minimise_by_annealing(
    evaluator: Evaluator, start: Array, generator: np.random.Generator
) -> Outcome:
    """How scipy's generalised simulated annealing ended; only the budget ends it.

    Local searches are off, because they would take differences of the deviance, blind to cliffs.
    """
    import scipy.optimize

    parameters = evaluator.parameters
    scipy.optimize.dual_annealing(
        # Half the deviance, the objective of the paper: temperatures are in its unit.
        lambda theta: min(0.5 * evaluator.deviance(theta), NO_PREDICTION),
        list(zip(parameters.lower, parameters.upper, strict=True)),
        x0=uniform_box(generator, 1, *_box(parameters, start))[0],
        # An iteration is at least one simulation; the evaluator's budget ends the loop.
        maxiter=evaluator.budget,
        initial_temp=INITIAL_TEMPERATURE,
        no_local_search=True,
        # The keyword was `seed` until scipy 1.15 and is still understood.
        seed=generator,
    )
    return Outcome.BUDGET


class PymooSearch:
    """A search by one of pymoo's algorithms."""

    def __init__(
        self, algorithm: Any, parameters: Parameters, start: Array, generator: np.random.Generator
    ) -> None:
        first = uniform_box(generator, POPULATION, *_box(parameters, start))
        self._problem = _imported("pymoo.core.problem").Problem(
            n_var=parameters.n,
            n_obj=1,
            xl=np.array(parameters.lower),
            xu=np.array(parameters.upper),
        )
        self._algorithm = algorithm(pop_size=POPULATION, sampling=first)
        self._algorithm.setup(
            self._problem,
            termination=_imported("pymoo.core.termination").NoTermination(),
            seed=int(generator.integers(2**31)),
        )
        self._asked: Any = None

    @property
    def population(self) -> Array:
        """The last offspring or particles."""
        return np.asarray(self._asked.get("X"), dtype=np.float64)

    def ask(self) -> Array:
        """Offspring or moved particles, shape ``(m, n)``."""
        self._asked = self._algorithm.ask()
        if self._asked is None or len(self._asked) == 0:
            return np.empty((0, self._problem.n_var))
        return np.asarray(self._asked.get("X"), dtype=np.float64)

    def tell(self, values: Array) -> None:
        """Take the deviances of those asked, shape ``(m,)``."""
        static = _imported("pymoo.problems.static").StaticProblem(self._problem, F=values[:, None])
        _imported("pymoo.core.evaluator").Evaluator().eval(static, self._asked)
        self._algorithm.tell(infills=self._asked)


class CmaSearch:
    """A search by CMA-ES."""

    def __init__(
        self, parameters: Parameters, start: Array, generator: np.random.Generator
    ) -> None:
        options = {
            "bounds": [list(parameters.lower), list(parameters.upper)],
            "CMA_stds": half_widths(parameters) / np.sqrt(3.0),
            "randn": lambda *shape: generator.standard_normal(shape),
            # Neither numpy's global generator nor a file of signals is to have a part in this.
            "seed": np.nan,
            "verbose": -10,
        }
        mean = np.clip(start, parameters.lower, parameters.upper)
        self._strategy = _imported("cma").CMAEvolutionStrategy(mean, 1.0, options)
        self.population = mean[None]

    def ask(self) -> Array:
        """A new generation, shape ``(m, n)``."""
        self.population = np.array(self._strategy.ask())
        return self.population

    def tell(self, values: Array) -> None:
        """Take the deviances of the generation, shape ``(m,)``."""
        self._strategy.tell(list(self.population), list(np.minimum(values, NO_PREDICTION)))


def _box(parameters: Parameters, start: Array) -> tuple[Array, Array]:
    widths = half_widths(parameters)
    low = np.clip(start - widths, parameters.lower, parameters.upper)
    high = np.clip(start + widths, parameters.lower, parameters.upper)
    return low, high


def _imported(module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        raise ModuleNotFoundError(
            f"this method needs the package {package}; "
            "install it with: pip install 'identknee[optimizers]'"
        ) from error


REFLECTION = 0.9
ATTEMPTS = 4


class Complex:
    """Box's Complex method with the rules of the paper.

    Twenty candidates are drawn uniformly from a box around the start, which is no member itself.
    The worst one is reflected through the centroid of the others, to 0.9 times its distance on
    the other side. While it stays worse than all others it is moved half the way to the centroid,
    four times at most; then it is replaced by a new random candidate from the box around the
    start. Values below a parameter's floor are lifted to the floor.

    Parameters
    ----------
    start
        Centre of the box, shape ``(n,)``.
    half_widths
        Half-widths of the box, shape ``(n,)``.
    floors
        Least values, shape ``(n,)``: zero for stiffnesses. There are no other bounds.
    generator
        Where the random numbers come from.

    Notes
    -----
    The paper leaves open what becomes of a candidate without a prediction: its deviance is
    infinite, which is never an improvement, so it is halved and then replaced like any other.
    A candidate as good as the second worst counts as improved.

    References
    ----------
    .. [1] Box (1965), The Computer Journal 8(1), 42-52. https://doi.org/10.1093/comjnl/8.1.42
    """

    def __init__(
        self,
        *,
        start: Array,
        half_widths: Array,
        floors: Array,
        generator: np.random.Generator,
    ) -> None:
        self._low = start - half_widths
        self._high = start + half_widths
        self._floors = floors
        self._generator = generator
        self._values = np.empty(0)
        self._centroid = np.empty(0)
        self._worst = 0
        self._halvings = 0
        self._asked = self._random(POPULATION)
        self.population = self._asked

    def ask(self) -> Array:
        """The twenty first candidates, then one at a time, shape ``(m, n)``."""
        return self._asked

    def tell(self, values: Array) -> None:
        """Take the deviances of the candidates last asked, shape ``(m,)``."""
        if self._values.size == 0:
            self._values = np.array(values)
            self._reflect()
            return
        others = np.delete(self._values, self._worst)
        improved = bool(np.isfinite(values[0]) and values[0] <= others.max())
        if improved or self._halvings > ATTEMPTS:
            self.population[self._worst] = self._asked[0]
            self._values[self._worst] = values[0]
            self._reflect()
        elif self._halvings < ATTEMPTS:
            self._halvings += 1
            self._asked = self._lifted(0.5 * (self._asked + self._centroid))
        else:
            # One more than the attempts: the random candidate stays, whatever its deviance.
            self._halvings += 1
            self._asked = self._random(1)

    def _reflect(self) -> None:
        self._worst = int(np.argmax(self._values))
        self._halvings = 0
        self._centroid = np.delete(self.population, self._worst, axis=0).mean(axis=0)
        away = self._centroid - self.population[self._worst]
        self._asked = self._lifted((self._centroid + REFLECTION * away)[None])

    def _random(self, n: int) -> Array:
        return self._lifted(uniform_box(self._generator, n, self._low, self._high))

    def _lifted(self, candidates: Array) -> Array:
        return np.maximum(candidates, self._floors)


def minimise_by_complex(
    evaluator: Evaluator, start: Array, generator: np.random.Generator
) -> Outcome:
    """How the Complex method ended; the evaluator remembers the best point."""
    parameters = evaluator.parameters
    search = Complex(
        start=start,
        half_widths=half_widths(parameters),
        floors=floors(parameters),
        generator=generator,
    )
    return run_search(search, evaluator)
