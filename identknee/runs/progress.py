"""A progress bar for whatever turns out to take more than two seconds."""

import multiprocessing
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn, TaskID

Item = TypeVar("Item")
DELAY_S = 2.0
_one_bar = threading.Lock()


def progress(
    items: Iterable[Item], *, total: int | None = None, description: str
) -> Iterator[Item]:
    """The same items, counted on a bar on standard error.

    The bar shows after two seconds and only on a terminal.

    Parameters
    ----------
    items
        What to go through.
    total
        How many there are, where `items` has no length.
    description
        What is being done.
    """
    if total is None and isinstance(items, Sized):
        total = len(items)
    with progress_bar(description, total) as advance:
        for item in items:
            yield item
            advance(1)


@contextmanager
def progress_bar(description: str, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """Function to be told how many more are done; the bar is drawn as in `progress`.

    One bar is drawn at a time, the outermost, and none in worker processes.

    Examples
    --------
    >>> with progress_bar("simulating", 63) as advance:
    ...     advance(63)
    """
    is_worker = multiprocessing.parent_process() is not None
    if is_worker or not sys.stderr.isatty() or not _one_bar.acquire(blocking=False):
        yield _say_nothing
        return
    bar = _DelayedBar(description, total)
    # A timer, so that a first step of a minute does not leave the terminal blank.
    timer = threading.Timer(DELAY_S, bar.show)
    timer.daemon = True
    timer.start()
    try:
        yield bar.advance
    finally:
        timer.cancel()
        timer.join()
        bar.close()
        _one_bar.release()


class _DelayedBar:
    """Counts from the start, drawn once it is shown."""

    def __init__(self, description: str, total: int | None) -> None:
        self._description = description
        self._total = total
        self._done = 0
        self._lock = threading.Lock()
        self._shown: tuple[Progress, TaskID] | None = None

    def show(self) -> None:
        # Imported here because rich takes longer to load than most commands run.
        from rich.console import Console
        from rich.progress import Progress

        bar = Progress(*_columns(self._total), console=Console(stderr=True))
        with self._lock:
            task = bar.add_task(self._description, total=self._total, completed=self._done)
            self._shown = (bar, task)
            bar.start()

    def advance(self, count: int) -> None:
        with self._lock:
            self._done += count
            if self._shown is not None:
                bar, task = self._shown
                bar.update(task, completed=self._done)

    def close(self) -> None:
        if self._shown is not None:
            self._shown[0].stop()


def _say_nothing(_count: int) -> None:
    pass


def _columns(total: int | None) -> tuple["ProgressColumn", ...]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

    text = TextColumn("{task.description}")
    if total is None:
        return text, MofNCompleteColumn(), TimeElapsedColumn()
    return text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
