"""What a result remembers of its run: how it ended, and the call that made it."""

import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import Enum, unique
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from identknee.runs.declare import declared, entry
from identknee.runs.files import plain

PACKAGES = ("identknee", "numpy", "scipy", "numba")


@declared
class Record:
    """The call, its inputs, seed, versions and time."""

    verb: str = entry("What was asked for, such as fit")
    settings: Mapping[str, Any] = entry("Every setting by name")
    inputs: Mapping[str, str] = entry(
        "SHA-256 of each input by name: the numbers of the subject, the bytes of a file"
    )
    seed: int | None = entry("Seed of all random numbers; null where nothing was random")
    versions: Mapping[str, str] = entry(
        "Version of Python and of each package that the numbers depend on"
    )
    started: str = entry("When it began, UTC")
    seconds: float = entry("Wall time of the whole call", unit="s")
    arrays: str = entry(
        "SHA-256 of result.nc, by which a damaged one is known", only="written", default=""
    )

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain JSON types."""
        # It loads what schemas need, which the start of a command should not wait for.
        from identknee.runs.schema import to_plain

        return {name: x for name, x in plain(to_plain(self)).items() if name != "arrays"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """A run under way; `finish` turns it into its record."""

    verb: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, str]
    seed: int | None
    started: str
    _clock_s: float = field(default_factory=time.perf_counter)

    def finish(self) -> Record:
        """Record of the run, its time counted up to now."""
        return Record(
            verb=self.verb,
            settings=self.settings,
            inputs=self.inputs,
            seed=self.seed,
            versions=versions(),
            started=self.started,
            seconds=time.perf_counter() - self._clock_s,
        )


def record(
    verb: str,
    settings: Mapping[str, Any],
    inputs: Mapping[str, str],
    seed: int | None = None,
) -> Recording:
    """Recording that starts its clock now; call its `finish` when the work is done.

    Raises
    ------
    TypeError
        If a setting has no JSON form.

    Examples
    --------
    >>> recording = record("fit", {"method": "complex"}, {}, seed=3)
    >>> recording.finish().verb
    'fit'
    """
    return Recording(
        verb=verb,
        settings=plain(dict(settings)),
        inputs=dict(inputs),
        seed=seed,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def versions() -> dict[str, str]:
    """Version of Python and of each package that numbers depend on, where installed."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


@unique
class Outcome(Enum):
    """How an equilibrium, a trial or a fit ended.

    The value is the word written to files; `sentence` says it to a person.
    """

    # Equilibria and trials.
    CONVERGED = "converged"
    FOLD = "fold"
    NO_EQUILIBRIUM = "no_equilibrium"
    UNCONSTRAINED = "unconstrained"
    # Fits.
    MINIMUM = "minimum"
    VALLEY = "valley"
    CLIFF = "cliff"
    BUDGET = "budget"
    SPREAD = "spread"
    START_FAILED = "start_failed"

    @property
    def sentence(self) -> str:
        """What happened, as a full sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    Outcome.CONVERGED: "A stable equilibrium was found on the branch that starts unloaded.",
    Outcome.FOLD: "No stable pose at full load: the simulated knee jumps before reaching it.",
    Outcome.NO_EQUILIBRIUM: "No equilibrium was found near the pose where the search began.",
    Outcome.UNCONSTRAINED: "One direction of motion has no stiffness: the pose is not unique. Is "
    "a ligament missing or slack?",
    Outcome.MINIMUM: "Exact derivatives confirm a local minimum.",
    Outcome.VALLEY: "The optimizer stopped in a valley before a minimum was reached.",
    Outcome.CLIFF: "The search stopped at a cliff, beyond which the simulated knee jumps.",
    Outcome.BUDGET: "The budget of simulations was exhausted.",
    Outcome.SPREAD: "The spread of the population fell below the tolerance.",
    Outcome.START_FAILED: "The model has no prediction at the start.",
}
