"""A progress bar, with the time left, for whatever turns out to take more than two seconds."""

import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING, Any, TypeVar

from typing_extensions import override

from identknee.runs.notebooks import is_notebook, shown_in_cell

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

# Least share of the work from which the time left is estimated.
LEAST_SHARE = 0.02


def time_left(elapsed_s: float, share: float, before: float = 0.0) -> float | None:
    """Seconds until all is done, at the speed so far; None while that is not known.

    `share` of the work is done, `before` was done when the time began.

    Examples
    --------
    >>> time_left(30.0, 0.25)
    90.0
    >>> time_left(30.0, 0.75, before=0.5)
    30.0
    """
    if share - before < LEAST_SHARE:
        return None
    return elapsed_s * max(1.0 - share, 0.0) / (share - before)


def in_words(seconds: float | None) -> str:
    """Time left, rounded as in speech.

    Examples
    --------
    >>> [in_words(x) for x in (None, 4.0, 87.0, 150.0, 4000.0)]
    ['', 'about 4 s left', 'about 90 s left', 'about 2 min left', 'about 1.1 h left']
    """
    if seconds is None:
        return ""
    if seconds < 120.0:
        rounded = round(seconds, -1) if seconds > 60.0 else round(max(seconds, 1.0))
        return f"about {rounded:.0f} s left"
    if seconds < 3600.0:
        return f"about {seconds / 60.0:.0f} min left"
    return f"about {seconds / 3600.0:.1f} h left"


class Advance:
    """A receiver of progress; this one shows nothing."""

    def __call__(self, count: int, /) -> None:
        """Count more items as done."""

    def to(self, share: float, note: str = "", left_s: float | None = None) -> None:
        """A share of all is done; `note` says more, `left_s` the time left where known [s]."""

    def say(self, sentence: str, /) -> None:
        """Say a sentence beside the bar."""


class _TimeLeftColumn:
    """The time left as it is when it is printed, also within an item that takes long."""

    def __init__(self, seconds: float | None) -> None:
        self._end = None if seconds is None else time.monotonic() + seconds

    @override
    def __str__(self) -> str:
        return in_words(None if self._end is None else self._end - time.monotonic())


class Display(Advance):
    """State of the progress of some work, shown when it changes."""

    def __init__(
        self, description: str, total: int | None, before: int, *, is_counted: bool
    ) -> None:
        self._description, self._is_counted = description, is_counted
        self._total, self._done = total, before
        self._share, self._before = 0.0, before / total if total else 0.0
        self._note, self._left = "", _TimeLeftColumn(None)
        self._began = time.monotonic()
        self._lock = threading.Lock()
        self._unsaid: list[str] = []

    @property
    def _elapsed_s(self) -> float:
        return time.monotonic() - self._began

    @override
    def __call__(self, count: int, /) -> None:
        with self._lock:
            self._done += count
            share = self._done / self._total if self._total else 0.0
            self._left = _TimeLeftColumn(time_left(self._elapsed_s, share, self._before))
            self._update()

    @override
    def to(self, share: float, note: str = "", left_s: float | None = None) -> None:
        with self._lock:
            if left_s is None:
                left_s = time_left(self._elapsed_s, share, self._before)
            self._share, self._note, self._left = share, note, _TimeLeftColumn(left_s)
            self._update()

    @override
    def say(self, sentence: str, /) -> None:
        with self._lock:
            self._unsaid.append(sentence)
            self._say_all()

    def show(self) -> None:
        """Start to show the progress."""

    def close(self) -> None:
        """Stop showing the progress."""

    def _update(self) -> None:
        """Show how far the work is now."""

    def _say_all(self) -> None:
        """Write the sentences that were not written yet."""
        for sentence in self._unsaid:
            sys.stderr.write(f"identknee: {sentence}\n")
        sys.stderr.flush()
        self._unsaid.clear()


# Time until the first line, and the longest time between lines, which grows up to it.
FIRST_LINE_S, MOST_RARELY_S = 30.0, 600.0


class ProgressLines(Display):
    """Lines on standard error that report the progress of long work."""

    _next_s = FIRST_LINE_S

    @override
    def _update(self) -> None:
        elapsed = self._elapsed_s
        if elapsed < self._next_s:
            return
        self._next_s = elapsed + min(elapsed, MOST_RARELY_S)
        state = f"{self._done} of {self._total}" if self._total else f"{self._done} done"
        if not self._is_counted:
            state = f"{100 * self._share:.0f} % done"
        words = ", ".join(x for x in (self._note, state, str(self._left)) if x)
        self._unsaid.append(f"{self._description}: {words}")
        self._say_all()


Item = TypeVar("Item")
DELAY_S = 2.0
# Work that will take longer than this says how it could be shortened.
LONG_S = 300.0
_one_bar = threading.Lock()
_plans: list["_Plan"] = []


def progress(
    items: Iterable[Item], *, total: int | None = None, description: str
) -> Iterator[Item]:
    """The items, counted on a bar on standard error as they pass.

    The bar shows after two seconds on a terminal or in a notebook. Elsewhere, as in a log, a line
    says how far long work is after 30 seconds and then ever more rarely.
    """
    if total is None and isinstance(items, Sized):
        total = len(items)
    with progress_bar(description, total) as advance:
        yield from counted(items, advance)


def counted(items: Iterable[Item], advance: Advance) -> Iterator[Item]:
    """The items, each counted by `advance` once it has been used."""
    for item in items:
        yield item
        advance(1)


@contextmanager
def stage(description: str) -> Iterator[None]:
    """One piece of `planned` work, done when the block ends."""
    with progress_bar(description, 1) as advance:
        yield
        advance(1)


@contextmanager
def whole_stage(description: str) -> Iterator[None]:
    """One piece of `planned` work whose parts are not shown."""
    with stage(description):
        _plans.append(_Plan({}, Advance()))
        try:
            yield
        finally:
            _plans.pop()


def finished(*descriptions: str) -> None:
    """Of these pieces of `planned` work no more will be done, though more were planned."""
    for plan in _plans[-1:]:
        plan.finish(descriptions)


@contextmanager
def progress_bar(
    description: str,
    total: int | None = None,
    *,
    before: int = 0,
    is_counted: bool = True,
    costs: Sequence[float] = (),
) -> Iterator[Advance]:
    """Function to call with how many more are done; the bar is drawn as in `progress`.

    One bar is drawn at a time, the outermost, and none in worker processes. Within `planned` work
    the bar is that of the plan.

    Parameters
    ----------
    description
        What is being done.
    total
        How many items there are; None where that is not known.
    before
        How many of them an earlier run did, from which no time follows.
    is_counted
        Whether items are counted; otherwise a share is shown.
    costs
        What each item costs, where that is better known now than it was to the plan.

    Examples
    --------
    >>> with progress_bar("simulating", 63) as advance:
    ...     advance(63)
    """
    if _plans:
        yield _plans[-1].part(description, total or 0, before, costs)
        return
    with _bar(description, total, before, is_counted=is_counted) as advance:
        yield advance


@contextmanager
def planned(
    description: str, work: Mapping[str, Sequence[float]], *, shorter: str = ""
) -> Iterator[None]:
    """One bar over several maps that follow one another, so that it knows when all are done.

    Parameters
    ----------
    description
        What is being done.
    work
        Costs of the items of each map, by the description of the map, relative to those of the
        other maps. Further items cost as much as the last one; maps not named cost nothing.
    shorter
        How the work could be shortened, written once if it turns out to take minutes.
    """
    if _plans:
        yield
        return
    with _bar(description, None, 0, is_counted=False) as advance:
        _plans.append(_Plan(work, advance, shorter))
        try:
            yield
        finally:
            _plans.clear()


@contextmanager
def _bar(
    description: str, total: int | None, before: int, *, is_counted: bool
) -> Iterator[Advance]:
    is_worker = multiprocessing.parent_process() is not None
    if is_worker or not _one_bar.acquire(blocking=False):
        yield Advance()
        return
    in_cell, is_terminal = is_notebook(), sys.stderr.isatty()
    drawn = _CellBar if in_cell else TerminalBar if is_terminal else ProgressLines
    bar = drawn(description, total, before, is_counted=is_counted)
    # A timer, so that a first step of a minute does not leave the terminal blank.
    timer = threading.Timer(DELAY_S, bar.show)
    timer.daemon = True
    timer.start()
    try:
        yield bar
    finally:
        timer.cancel()
        timer.join()
        bar.close()
        _one_bar.release()


class TerminalBar(Display):
    """A bar on a terminal, drawn once it is shown."""

    _shown: "tuple[Progress, TaskID] | None" = None

    @override
    def show(self) -> None:
        # Imported here because rich takes longer to load than most commands run.
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
        )

        bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            *([MofNCompleteColumn()] if self._is_counted else []),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]} {task.fields[note]}"),
            console=Console(stderr=True),
        )
        with self._lock:
            task = bar.add_task(self._description, total=self._total, left="", note="")
            self._shown = (bar, task)
            self._update()
            bar.start()
            self._say_all()

    @override
    def _say_all(self) -> None:
        if self._shown is None:
            return
        for sentence in self._unsaid:
            self._shown[0].console.print(f"identknee: {sentence}", markup=False)
        self._unsaid.clear()

    @override
    def _update(self) -> None:
        if self._shown is None:
            return
        bar, task = self._shown
        texts: dict[str, Any] = {"left": self._left, "note": self._note}
        if self._share:
            bar.update(task, total=1.0, completed=self._share, **texts)
        else:
            bar.update(task, completed=self._done, **texts)

    @override
    def close(self) -> None:
        if self._shown is not None:
            self._shown[0].stop()


# Least time between two changes of a cell.
CELL_EVERY_S = 0.2


class _CellBar(Display):
    """A bar in the output of a notebook's cell, where lines would pile up."""

    _change: Callable[[str, str], None] | None = None
    _changed = 0.0

    @override
    def show(self) -> None:
        with self._lock:
            self._change = shown_in_cell(*self._looks())
            self._changed = time.monotonic()
            self._say_all()

    @override
    def _say_all(self) -> None:
        if self._change is not None:
            super()._say_all()

    @override
    def _update(self) -> None:
        if self._change is not None and time.monotonic() - self._changed >= CELL_EVERY_S:
            self._change(*self._looks())
            self._changed = time.monotonic()

    @override
    def close(self) -> None:
        if self._change is not None:
            self._left, self._note = _TimeLeftColumn(None), ""
            self._change(*self._looks())

    def _looks(self) -> tuple[str, str]:
        """The bar as HTML and as text."""
        whole = 1.0 if self._share else float(self._total or 0)
        done = self._share or float(self._done)
        count = f"{self._done}/{self._total or '?'}" if self._is_counted else ""
        texts = [self._description, count, f"{self._elapsed_s:.0f} s", str(self._left), self._note]
        words = ", ".join(x for x in texts if x)
        place = f' value="{min(done, whole):g}" max="{whole:g}"' if whole else ""
        bar = f'<progress{place} aria-label="{escape(self._description)}"></progress>'
        return f"<div>{bar} {escape(words)}</div>", words


class _Plan:
    """Adds up what the maps of a plan have done."""

    def __init__(
        self, work: Mapping[str, Sequence[float]], advance: Advance, shorter: str = ""
    ) -> None:
        self._shorter = shorter
        self._costs = {name: list(costs) for name, costs in work.items()}
        self._done = dict.fromkeys(work, 0)
        self._before, self._share = 0.0, 0.0
        self._began = time.monotonic()
        self._advance = advance

    def part(self, description: str, total: int, before: int, known: Sequence[float]) -> Advance:
        """The progress of one map, whose first items are done already."""
        costs = self._costs.get(description)
        if not costs:
            return Advance()
        first = self._done[description]
        if known:
            costs[first:] = known
        costs += [costs[-1]] * (first + total - len(costs))
        self._before += sum(costs[first : first + before])
        self.add(description, before)
        return _Part(self, description)

    def say(self, sentence: str) -> None:
        """Say a sentence beside the bar."""
        self._advance.say(sentence)

    def add(self, description: str, count: int) -> None:
        """Tell the bar that so many items of a map are done."""
        self._done[description] += count
        self._tell(description)

    def finish(self, descriptions: Sequence[str]) -> None:
        """Tell the bar that of these maps no more items will be done."""
        for x in descriptions:
            if x in self._costs:
                self._done[x] = len(self._costs[x])
                self._tell(x)

    def _tell(self, description: str) -> None:
        whole = sum(map(sum, self._costs.values()))
        done = sum(sum(costs[: self._done[name]]) for name, costs in self._costs.items())
        # What turns out to cost more does not undo what was done.
        self._share = max(self._share, done / whole)
        share, before = self._share, self._before / whole
        elapsed = time.monotonic() - self._began
        left = time_left(elapsed, share, before)
        if self._shorter and left is not None and left > LONG_S:
            self._advance.say(f"{in_words(left)}. {self._shorter}")
            self._shorter = ""
        self._advance.to(share, description, left)


class _Part(Advance):
    def __init__(self, plan: _Plan, description: str) -> None:
        self._plan = plan
        self._description = description

    @override
    def __call__(self, count: int, /) -> None:
        self._plan.add(self._description, count)

    @override
    def say(self, sentence: str, /) -> None:
        self._plan.say(sentence)
