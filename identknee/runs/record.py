"""Provenance of a result: the call that made it, and how equilibria and fits ended."""

import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import Enum, unique
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Self

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
    """Versions of Python and of the installed packages that numbers depend on, by name."""
    return dict(_versions())


# What is imported stays what it is, whatever is installed meanwhile.
@cache
def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


class WithSentence(Enum):
    """A code written to files, with a `sentence` that explains it."""

    _value_: str
    sentence: str

    def __new__(cls, word: str, sentence: str = "") -> Self:
        """The member of a word."""
        member = object.__new__(cls)
        member._value_, member.sentence = word, sentence
        return member


@unique
class Outcome(WithSentence):
    """How an equilibrium, a trial or a fit ended."""

    # Equilibria and trials.
    CONVERGED = ("converged", "A stable equilibrium was found on the branch that starts unloaded.")
    FOLD = ("fold", "No stable pose at full load: the simulated knee jumps before reaching it.")
    NO_EQUILIBRIUM = (
        "no_equilibrium",
        "No equilibrium was found near the pose where the search began.",
    )
    UNCONSTRAINED = (
        "unconstrained",
        (
            "One direction of motion has no stiffness: the pose is not unique. Is a ligament "
            "missing or slack?"
        ),
    )
    # Fits.
    MINIMUM = ("minimum", "Exact derivatives confirm a local minimum.")
    VALLEY = ("valley", "The optimizer stopped in a valley before a minimum was reached.")
    CLIFF = ("cliff", "The search stopped at a cliff, beyond which the simulated knee jumps.")
    BUDGET = ("budget", "The budget of simulations was exhausted.")
    SPREAD = ("spread", "The spread of the population fell below the tolerance.")
    START_FAILED = ("start_failed", "The model has no prediction at the start.")
