"""Many mutated inputs over all readers and verbs: `python tests/fuzz/run_fuzz.py --inputs 20000`.

Prints how they ended; `tests/verification/run_verification.py --only fuzz` records it. Inputs that
ended in another way than with success or a sentence are kept in the folder `--keep`, to become
tests in `kept/`.
"""

import argparse
import hashlib
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "support"))

from fuzz_judge import Ending, judged
from fuzz_targets import TARGETS, Target
from hypothesis import HealthCheck, Phase, given, seed, settings


@dataclass(kw_only=True)
class Tally:
    """How the inputs of one target ended."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0

    def add(self, ending: Ending) -> None:
        """Count one more."""
        self.counts[ending.kind] += 1
        self.slowest_s = max(self.slowest_s, ending.seconds)
        if ending.kind == "failed":
            self.failures[ending.what] += 1


def tallied(target: Target, inputs: int, number: int, keep: Path | None = None) -> Tally:
    """How the target's share of so many inputs ended."""
    tally = Tally()
    n = -(-inputs * target.share // sum(x.share for x in TARGETS))
    for content, ending in endings(target, n, number):
        tally.add(ending)
        if ending.kind == "failed":
            _keep(keep, target, content)
    return tally


def endings(target: Target, n: int, number: int) -> Iterator[tuple[bytes, Ending]]:
    """How `n` inputs of a target end, the same ones for the same `number`.

    They are drawn in one go before any is used, a hundred at a time.
    """
    for batch in range(0, n, 100):
        for content in _drawn(target, min(100, n - batch), number + batch):
            with tempfile.TemporaryDirectory() as folder:
                place = Path(folder)
                yield content, judged(lambda: target.run(content, place))  # noqa: B023


def _drawn(target: Target, n: int, number: int) -> list[bytes]:
    found: list[bytes] = []

    @seed(number)
    @settings(
        max_examples=n,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.generate],
    )
    @given(target.inputs())
    def draw(content: bytes) -> None:
        found.append(content)

    draw()
    return found[:n]


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 1 where an input ended badly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", help="names of targets")
    parser.add_argument("--keep", type=Path, help="folder for inputs that ended badly")
    options = parser.parse_args(arguments)
    n_failed = 0
    for target in TARGETS:
        if options.only and target.name not in options.only:
            continue
        tally = tallied(target, options.inputs, options.seed, options.keep)
        print(target.name, dict(tally.counts), f"{tally.slowest_s:.2f} s", flush=True)
        for what, count in tally.failures.most_common():
            print(f"   {count} x {what}", flush=True)
        n_failed += tally.counts["failed"]
    return int(n_failed > 0)


def _keep(folder: Path | None, target: Target, content: bytes) -> None:
    if folder is not None:
        place = folder / target.name
        place.mkdir(parents=True, exist_ok=True)
        (place / hashlib.sha256(content).hexdigest()[:12]).write_bytes(content)


if __name__ == "__main__":
    sys.exit(main())
