"""The population methods the paper asks future work to try, from pymoo, cma and scipy.

All start in the paper's box around the start, cut to the parameters' bounds, search within these
bounds, and know of infinite deviances only that they are worse than all others.
"""

import importlib
from typing import Any

import numpy as np

from identknee.calibrate.evaluation import Evaluator
from identknee.calibrate.problem import half_widths
from identknee.calibrate.search import POPULATION, run_search, uniform_box
from identknee.model.parameters import Parameters
from identknee.runs.arrays import Array
from identknee.runs.record import Outcome

# Stands for infinity where a library takes differences of deviances.
NO_PREDICTION = 1e100
# scipy's 5,230 jumps all over the bounds: with it, 2,500 simulations of eight springs
# (tests/problems.py) from a start near the minimum never went below the start.
INITIAL_TEMPERATURE = 10.0


def minimise_by_genetic(
    evaluator: Evaluator, start: Array, generator: np.random.Generator
) -> Outcome:
    """How pymoo's genetic algorithm with 20 members ended."""
    module = _imported("pymoo.algorithms.soo.nonconvex.ga")
    search = PymooSearch(module.GA, evaluator.parameters, start, generator)
    return run_search(search, evaluator)


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
    """A search by one of pymoo's algorithms.

    Parameters
    ----------
    algorithm
        Class of the algorithm.
    parameters
        The parameters, for their bounds and the box of first candidates.
    start
        Centre of that box, shape ``(n,)``.
    generator
        Draws the first candidates and the seed of the algorithm.
    """

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
    """A search by CMA-ES.

    Parameters
    ----------
    parameters
        The parameters, for their bounds and the widths of the first normal.
    start
        Its mean, moved into the bounds, shape ``(n,)``.
    generator
        Where the random numbers come from.
    """

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
