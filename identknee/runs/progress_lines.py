"""How far long work is, on lines for where no bar can be drawn, as in a log."""

import sys
import threading
import time

from identknee.runs.time_left import in_words, time_left

# The first line comes after so long, the next ever more rarely.
FIRST_LINE_S, MOST_RARELY_S = 30.0, 600.0


class Lines:
    """Says on lines of standard error how far long work is."""

    def __init__(self, description: str, total: int | None, before: int) -> None:
        self._description = description
        self._total, self._done = total, before
        self._before = before / total if total else 0.0
        self._began = time.monotonic()
        self._next_s = FIRST_LINE_S
        self._lock = threading.Lock()

    def __call__(self, count: int, /) -> None:
        """So many items more are done."""
        with self._lock:
            self._done += count
            elapsed = time.monotonic() - self._began
            if not self._total:
                self._line(elapsed, f"{self._done} done", None)
                return
            share = self._done / self._total
            left = time_left(elapsed, share, self._before)
            self._line(elapsed, f"{self._done} of {self._total}", left)

    def to(self, share: float, note: str = "", left_s: float | None = None) -> None:
        """A share of all is done; `note` says more, `left_s` the time left where known [s]."""
        with self._lock:
            elapsed = time.monotonic() - self._began
            left = time_left(elapsed, share, self._before) if left_s is None else left_s
            told = f"{100 * share:.0f} % done"
            self._line(elapsed, f"{note}, {told}" if note else told, left)

    def say(self, sentence: str, /) -> None:
        """Say a sentence on a line of its own."""
        sys.stderr.write(f"identknee: {sentence}\n")
        sys.stderr.flush()

    def _line(self, elapsed_s: float, told: str, left_s: float | None) -> None:
        if elapsed_s < self._next_s:
            return
        self._next_s = elapsed_s + min(elapsed_s, MOST_RARELY_S)
        left = in_words(left_s)
        self.say(f"{self._description}: {told}{f', {left}' if left else ''}")
