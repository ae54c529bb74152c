"""An executor whose tasks go there and back as those of other processes do, without any."""

import pickle
from collections.abc import Callable, Iterable, Iterator
from typing import Any


class Elsewhere:
    """An executor that pickles functions, items and results, and counts what it did."""

    def __init__(self) -> None:
        self.n_done = 0

    def map(self, function: Callable[[Any], Any], items: Iterable[Any], /) -> Iterator[Any]:
        for item in items:
            done = pickle.loads(pickle.dumps(function))(pickle.loads(pickle.dumps(item)))
            self.n_done += 1
            yield pickle.loads(pickle.dumps(done))
