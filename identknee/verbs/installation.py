"""Whether this installation is sound, and what to do where it is not."""

import os
import platform
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution, version
from itertools import groupby
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from identknee.runs.cache_folder import cache_folder
from identknee.runs.declare import declared, derived, entry
from identknee.runs.errors import InputError
from identknee.runs.files import BYTES_PER_MB, prepare_folder
from identknee.runs.library_threads import LIBRARY_THREADS

# Extras for work on identknee itself; a user misses nothing without them.
FOR_DEVELOPERS = {"benchmarks", "docs", "lint", "test"}
INSTALL_AGAIN = "Install it again from its checkout: pip install --force-reinstall ."


@declared
class Check:
    """One thing looked at."""

    group: str = entry("What it belongs to: versions, machine, cache, extras or self-test")
    name: str = entry("Name of what was looked at")
    is_sound: bool = entry("Whether it is as it should be; an extra may be missing and still be so")
    found: str = entry("What was found")
    remedy: str = entry(
        "What to do about it, a sentence; empty where there is nothing to do", default=""
    )

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """The check as a line for a person."""
        mark = "  ok  " if self.is_sound else "  FAIL"
        text = f"{mark}  {self.name}: {self.found}"
        return f"{text}. {self.remedy}" if self.remedy else text


@declared
class Installation:
    """All that was looked at in an installation."""

    checks: tuple[Check, ...] = entry("What was looked at")

    @property
    @derived("Whether all is as it should be")
    def is_sound(self) -> bool:
        """Whether all is as it should be."""
        return all(x.is_sound for x in self.checks)

    @property
    def failure(self) -> str:
        """What is wrong; empty where all is as it should be."""
        failed = [x.name for x in self.checks if not x.is_sound]
        if not failed:
            return ""
        return (
            f"{len(failed)} of {len(self.checks)} checks failed ({', '.join(failed)}). "
            "Do what their lines say, then run again: identknee doctor"
        )

    # typing.override came with Python 3.12.
    def __str__(self) -> str:  # type: ignore[explicit-override]
        """The checks, a line each, under their groups."""
        lines: list[str] = []
        for group, checks in groupby(self.checks, lambda x: x.group):
            lines += [group.capitalize(), *map(str, checks)]
        return "\n".join([*lines, *(["All is as it should be."] if self.is_sound else [])])


def doctor() -> Installation:
    """Versions, cores, cache and extras of this installation, and a short self-test.

    The self-test repeats known trials of the reference knee. The first one after an installation
    compiles, which takes up to a minute.
    """
    parts = (versions, machine, cache, extras, self_test)
    return Installation(checks=tuple(check for part in parts for check in part()))


def versions() -> Iterator[Check]:
    """Python, identknee and every package it needs, against the versions it asks for."""
    its = _distribution()
    if its is None:
        found, remedy = "not installed, only found on the path", "Install it: pip install ."
        yield Check(group="versions", name="identknee", is_sound=False, found=found, remedy=remedy)
        return
    yield Check(group="versions", name="identknee", is_sound=True, found=its.version)
    python, wanted = platform.python_version(), its.metadata["Requires-Python"]
    fits = SpecifierSet(wanted).contains(python, prereleases=True)
    yield Check(
        group="versions",
        name="Python",
        is_sound=fits,
        found=f"{python} ({sys.executable})",
        remedy="" if fits else f"Make an environment with Python {wanted} and install there.",
    )
    for text in its.requires or ():
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield _version_of(requirement)


def machine() -> Iterator[Check]:
    """Processor cores and threads."""
    total = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else total
    found = f"{usable} of {total} can be used; more than one work with --workers"
    yield Check(group="machine", name="cores", is_sound=True, found=found)
    threads = ", ".join(f"{x}={os.environ.get(x, 'unset')}" for x in LIBRARY_THREADS)
    yield Check(group="machine", name="threads of linear algebra", is_sound=True, found=threads)


def cache() -> Iterator[Check]:
    """The folder of compiled code and distance fields: writable, how large, and what is in it."""
    folder = cache_folder()
    try:
        prepare_folder(folder)
    except InputError as error:
        yield Check(
            group="cache",
            name="folder",
            is_sound=False,
            found=f"{folder}: {error.why}",
            remedy="Name a folder that can be written to in the environment variable "
            "IDENTKNEE_CACHE; without one every process compiles again.",
        )
        return
    size = sum(x.stat().st_size for x in folder.rglob("*") if x.is_file())
    found = f"{folder}, can be written to, {size / BYTES_PER_MB:.0f} MB"
    yield Check(group="cache", name="folder", is_sound=True, found=found)
    n = _n_compiled()
    found = f"{n} compiled functions are there" if n else "none yet; the first command compiles"
    yield Check(group="cache", name="compiled code", is_sound=True, found=found)


def extras() -> Iterator[Check]:
    """The optional parts, and how to add those that are missing."""
    its = _distribution()
    if its is None:
        return
    requirements = [Requirement(text) for text in its.requires or ()]
    for extra in sorted(set(its.metadata.get_all("Provides-Extra") or ()) - FOR_DEVELOPERS):
        its_own = [
            _version_of(x)
            for x in requirements
            if x.marker is not None
            and x.marker.evaluate({"extra": extra})
            and not x.marker.evaluate({"extra": ""})
        ]
        missing = [x.name for x in its_own if not x.is_sound]
        yield Check(
            group="extras",
            name=extra,
            is_sound=True,
            found=f"not there: {', '.join(missing)}" if missing else "there",
            remedy=f"To add it: pip install 'identknee[{extra}]'" if missing else "",
        )


def self_test() -> Iterator[Check]:
    """Trials of the reference knee against stored ones, derivatives against differences, a fit."""
    try:
        from identknee.verbs.self_test import self_tests

        for name, is_sound, found in self_tests():
            yield Check(
                group="self-test",
                name=name,
                is_sound=is_sound,
                found=found,
                remedy="" if is_sound else f"Trust no result of this installation. {INSTALL_AGAIN}",
            )
    # A broken installation may raise anything, and what it is is the answer.
    except Exception as error:  # noqa: BLE001
        found = f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(".")
        yield Check(
            group="self-test", name="run", is_sound=False, found=found, remedy=INSTALL_AGAIN
        )


def _distribution() -> Distribution | None:
    try:
        return distribution("identknee")
    except PackageNotFoundError:
        return None


def _version_of(requirement: Requirement) -> Check:
    wanted = str(requirement.specifier)
    try:
        found = version(requirement.name)
    except PackageNotFoundError:
        fits, found = False, "not installed"
    else:
        fits = requirement.specifier.contains(found, prereleases=True)
        found = found if fits else f"{found}, but {wanted} is needed"
    return Check(
        group="versions",
        name=requirement.name,
        is_sound=fits,
        found=found,
        remedy="" if fits else f"Install it: pip install '{requirement.name}{wanted}'",
    )


def _n_compiled() -> int:
    """How many functions are kept compiled for this version of the sources."""
    # The compiler takes half a second to load.
    from identknee.runs.compiling import compiled_folder

    mechanics = Path(__file__).parents[1] / "mechanics"
    return len(list(compiled_folder(mechanics).rglob("*.nbc")))
