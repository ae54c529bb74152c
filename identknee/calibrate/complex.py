"""The Complex method as the paper used it, as an ask-and-tell search."""

import numpy as np

from identknee.calibrate.evaluation import Evaluator
from identknee.calibrate.problem import floors, half_widths
from identknee.calibrate.search import POPULATION, run_search, uniform_box
from identknee.runs.arrays import Array
from identknee.runs.record import Outcome

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
