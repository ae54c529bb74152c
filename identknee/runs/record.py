"""What a result remembers of the run that made it."""

import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Any

from identknee.runs.files import plain

PACKAGES = ("identknee", "numpy", "scipy", "numba")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """The call, its inputs, seed, versions and time.

    Attributes
    ----------
    verb
        What was asked for, for example ``"fit"``.
    settings
        Every setting by name, in JSON types.
    inputs
        SHA-256 of each input by name (see `identknee.runs.files.digest`).
    seed
        The seed, None where nothing was random.
    versions
        Version of Python and of each package that the numbers depend on.
    started
        When it began: ISO 8601, UTC.
    seconds
        How long it took [s].
    """

    verb: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, str]
    seed: int | None
    versions: Mapping[str, str]
    started: str
    seconds: float

    def __post_init__(self) -> None:
        for name in ("settings", "inputs", "versions"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    # A mapping proxy cannot be pickled, and records travel between processes.
    def __reduce__(self) -> tuple[Any, ...]:  # type: ignore[explicit-override]
        """How to pickle a record."""
        return _from_dict, (self.to_dict(),)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain JSON types."""
        return {
            "verb": self.verb,
            "settings": plain(dict(self.settings)),
            "inputs": dict(self.inputs),
            "seed": self.seed,
            "versions": dict(self.versions),
            "started": self.started,
            "seconds": self.seconds,
        }


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


def _from_dict(values: Mapping[str, Any]) -> Record:
    return Record(**values)
