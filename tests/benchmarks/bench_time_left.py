"""How right the time left is that a bar says after a quarter of the run, in processor time."""

import argparse
import contextlib
import time
from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from requirement_rows import Measure, Row

import identknee as ik
from identknee.runs import progress
from identknee.runs.progress import time_left

QUARTER, MOST_AWAY = 0.25, 0.30
NOISE = "0.3mm,0.3deg"
CAUSES = (
    "meniscus", "bundles", "axis_misalignment", "anterolateral", "deep_mcl", "compression",
    "tibia_frame", "mcl_wrapping", "parasitic_shear", "posterior_capsule",
)  # fmt: skip
FIRST_SEED, SIGNAL, UNCERTAIN = 170_000, 10.0, "insertions=2mm"


class _Bar:
    """Keeps the end that is told, and when."""

    def __init__(self, total: int | None) -> None:
        self.told: list[tuple[float, float]] = []
        self._total, self._done, self._began = total, 0, time.process_time()

    def __call__(self, count: int, /) -> None:
        self._done += count
        if self._total:
            self.to(self._done / self._total)

    def to(self, share: float, _note: str = "", left_s: float | None = None) -> None:
        now = time.process_time()
        if left_s is None:
            left_s = time_left(now - self._began, share)
        if left_s is not None:
            self.told.append((now, now + left_s))


def measure(options: argparse.Namespace) -> Row:
    """Time left said over time left, of every verb that says it."""
    knee = ik.example("reference")
    simulated = (ik.simulate(knee, noise=NOISE, seed=100 + i) for i in range(6))
    data = [x.noisy for x in simulated if x.noisy is not None]
    hidden = [_hidden(knee, i, x) for i, x in enumerate(CAUSES)]
    runs: dict[str, list[Callable[[], Any]]] = {
        "sweep": [partial(ik.sweep, knee, data[0]), partial(ik.sweep, knee, data[1], n_starts=200)],
        "sensitivity": [partial(ik.sensitivity, knee, data[0])],
        "equivalents": [partial(ik.equivalents, knee, x) for x in data[:3]],
        "sample": [partial(ik.sample, knee, x) for x in data],
        "diagnose, geometry exact": [partial(ik.diagnose, knee, x) for x in hidden],
        "diagnose, insertions uncertain": [
            partial(ik.diagnose, knee, x, uncertain=UNCERTAIN) for x in hidden[:4]
        ],
    }
    measures, notes = [], []
    for verb, calls in runs.items():
        ratios = [_ratio(x) for x in calls]
        within = sum(abs(x - 1.0) <= MOST_AWAY for x in ratios) / len(ratios)
        measures.append(
            Measure(
                what=f"{verb}: runs whose time left is within 30 % after a quarter",
                value=within,
                unit="",
                bar=1.0,
                at_least=True,
                count=len(ratios),
            )
        )
        notes.append(f"{verb}: said over true {', '.join(f'{x:.2f}' for x in ratios)}")
    return Row(
        line="time left within 30 % after a quarter of the run, reference knee, one core",
        measures=measures,
        notes=notes,
    )


def _hidden(knee: ik.Knee, number: int, cause: str) -> ik.Laxity:
    case = ik.blind.blind_case(knee, seed=FIRST_SEED + number, effect=(cause,), signal=SIGNAL)
    return case.laxity


def _ratio(run: Callable[[], Any]) -> float:
    """The time left that is shown at a quarter of the processor time, over the true one."""
    bars: list[_Bar] = []
    drawn: set[str] = set()

    @contextlib.contextmanager
    def bar(_: str, total: int | None, *__: Any, **___: Any) -> Iterator[Any]:
        if drawn:
            yield progress.Advance()
            return
        drawn.add("one bar at a time")
        bars.append(_Bar(total))
        try:
            yield bars[-1]
        finally:
            drawn.clear()

    clock = SimpleNamespace(monotonic=time.process_time)
    told = "identknee.runs.progress"
    with (
        patch(f"{told}._bar", bar),
        patch(f"{told}.time", clock),
        patch("identknee.identify.posterior.sample.time", clock),
    ):
        began = time.process_time()
        run()
        ended = time.process_time()
    quarter = began + QUARTER * (ended - began)
    ends = [end for x in bars for at, end in x.told if at <= quarter]
    return max(ends[-1] - quarter, 0.0) / (ended - quarter) if ends else 0.0
