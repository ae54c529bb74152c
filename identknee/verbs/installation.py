"""Whether this installation is sound, and what to do where it is not."""

import os
import platform
import sys
import time
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution, version
from importlib.resources import as_file, files
from itertools import groupby
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from typing_extensions import override

from identknee.calibrate.fit import fit, load_start
from identknee.laxity.protocol import load_protocol
from identknee.laxity.table import Laxity, read_laxity
from identknee.model.laxity_model import LaxityModel
from identknee.model.residuals import LaxityResiduals
from identknee.runs.declare import declared, derived, entry
from identknee.runs.errors import InputError
from identknee.runs.executors import LIBRARY_THREADS
from identknee.runs.files import BYTES_PER_MB, cache_folder, prepare_folder
from identknee.runs.progress import progress_bar
from identknee.subject.reference import reference_knee

# Extras for work on identknee itself; a user misses nothing without them.
FOR_DEVELOPERS = {"benchmarks", "docs", "lint", "test"}
INSTALL_AGAIN = "Install it again from its checkout: pip install --force-reinstall ."


@declared
class InstallationCheck:
    """One thing looked at."""

    group: str = entry("What it belongs to: versions, machine, cache, extras or self-test")
    name: str = entry("Name of what was looked at")
    is_sound: bool = entry("Whether it is as it should be; an extra may be missing and still be so")
    found: str = entry("What was found")
    remedy: str = entry(
        "What to do about it, a sentence; empty where there is nothing to do", default=""
    )

    @override
    def __str__(self) -> str:
        """The check as a line for a person."""
        mark = "  ok  " if self.is_sound else "  FAIL"
        text = f"{mark}  {self.name}: {self.found}"
        return f"{text}. {self.remedy}" if self.remedy else text


@declared
class Installation:
    """All that was looked at in an installation."""

    checks: tuple[InstallationCheck, ...] = entry("What was looked at")

    @property
    @derived("Whether all is as it should be")
    def is_sound(self) -> bool:
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

    @override
    def __str__(self) -> str:
        """The checks, a line each, under their groups."""
        lines: list[str] = []
        for group, checks in groupby(self.checks, lambda x: x.group):
            lines += [group.capitalize(), *map(str, checks)]
        return "\n".join([*lines, *(["All checks passed."] if self.is_sound else [])])


def _check(
    group: str, name: str, found: str, remedy: str = "", *, is_sound: bool = True
) -> InstallationCheck:
    return InstallationCheck(group=group, name=name, is_sound=is_sound, found=found, remedy=remedy)


def doctor() -> Installation:
    """Versions, cores, cache and extras of this installation, and a short self-test.

    The self-test repeats known trials of the reference knee. The first one after an installation
    compiles, which takes up to a minute.
    """
    parts = (versions, machine, cache, extras, self_test)
    return Installation(checks=tuple(check for part in parts for check in part()))


def versions() -> Iterator[InstallationCheck]:
    """Python, identknee and every package it needs, against the versions it asks for."""
    its = _distribution()
    if its is None:
        found, remedy = "not installed, only found on the path", "Install it: pip install ."
        yield _check("versions", "identknee", found, remedy, is_sound=False)
        return
    yield _check("versions", "identknee", its.version)
    python, wanted = platform.python_version(), its.metadata["Requires-Python"]
    fits = SpecifierSet(wanted).contains(python, prereleases=True)
    yield _check(
        "versions",
        "Python",
        f"{python} ({sys.executable})",
        "" if fits else f"Make an environment with Python {wanted} and install there.",
        is_sound=fits,
    )
    for text in its.requires or ():
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield _version_of(requirement)


def machine() -> Iterator[InstallationCheck]:
    """Processor cores and threads."""
    total = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else total
    found = f"{usable} of {total} can be used; more than one work with --workers"
    yield _check("machine", "cores", found)
    threads = ", ".join(f"{x}={os.environ.get(x, 'unset')}" for x in LIBRARY_THREADS)
    yield _check("machine", "threads of linear algebra", threads)


def cache() -> Iterator[InstallationCheck]:
    """The folder of compiled code and distance fields: writable, how large, and what is in it."""
    folder = cache_folder()
    try:
        prepare_folder(folder)
    except InputError as error:
        yield _check(
            "cache",
            "folder",
            f"{folder}: {error.why}",
            "Name a folder that can be written to in the environment variable "
            "IDENTKNEE_CACHE; without one every process compiles again.",
            is_sound=False,
        )
        return
    size = sum(x.stat().st_size for x in folder.rglob("*") if x.is_file())
    found = f"{folder}, can be written to, {size / BYTES_PER_MB:.0f} MB"
    yield _check("cache", "folder", found)
    # The compiler takes half a second to load.
    from identknee.runs.compiling import compiled_folder

    mechanics = Path(__file__).parents[1] / "mechanics"
    n = len(list(compiled_folder(mechanics).rglob("*.nbc")))
    found = f"{n} compiled functions are there" if n else "none yet; the first command compiles"
    yield _check("cache", "compiled code", found)


def extras() -> Iterator[InstallationCheck]:
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
        yield _check(
            "extras",
            extra,
            f"not there: {', '.join(missing)}" if missing else "there",
            f"To add it: pip install 'identknee[{extra}]'" if missing else "",
        )


def self_test() -> Iterator[InstallationCheck]:
    """Trials of the reference knee against stored ones, derivatives against differences, a fit."""
    try:
        for name, is_sound, found in self_tests():
            yield _check(
                "self-test",
                name,
                found,
                "" if is_sound else f"Do not use results of this installation. {INSTALL_AGAIN}",
                is_sound=is_sound,
            )
    # A broken installation may raise anything, and what it is is the answer.
    except Exception as error:  # noqa: BLE001
        found = f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(".")
        yield _check("self-test", "run", found, INSTALL_AGAIN, is_sound=False)


def _distribution() -> Distribution | None:
    try:
        return distribution("identknee")
    except PackageNotFoundError:
        return None


def _version_of(requirement: Requirement) -> InstallationCheck:
    wanted = str(requirement.specifier)
    try:
        found = version(requirement.name)
    except PackageNotFoundError:
        fits, found = False, "not installed"
    else:
        fits = requirement.specifier.contains(found, prereleases=True)
        found = found if fits else f"{found}, but {wanted} is needed"
    return _check(
        "versions",
        requirement.name,
        found,
        "" if fits else f"Install it: pip install '{requirement.name}{wanted}'",
        is_sound=fits,
    )


# Numbers of the same program on another machine: rounding may differ, nothing else.
SAME_MM_OR_DEG = 1e-6
# Half the step of a central difference [kN and %], and what it can be trusted to, as a share of
# the largest derivative.
STEP, SAME_SLOPE = 1e-3, 1e-4
# Where least squares stops on data without noise.
SAME_KN_OR_PCT = 1e-6


def self_tests() -> Iterator[tuple[str, bool, str]]:
    """Name of each test, whether it passed, and what it found."""
    with progress_bar("preparing, longer the first time after an installation"):
        with as_file(files("identknee.verbs").joinpath("self_test.csv")) as path:
            stored = read_laxity(path)
        model = LaxityModel(knee=reference_knee(), protocol=stored.protocol)
        model.predict(model.parameters.center)
    for name, test in (("poses", _poses), ("derivatives", _derivatives), ("fit", _fit)):
        began = time.perf_counter()
        is_sound, found = test(model, stored)
        yield name, is_sound, f"{found} ({time.perf_counter() - began:.2f} s)"


def _poses(model: LaxityModel, stored: Laxity) -> tuple[bool, str]:
    difference = abs(model.simulate(model.parameters.center).coordinates - stored.coordinates)
    largest = float(difference.max())
    found = f"{stored.n} trials of the reference knee are {largest:.1g} mm or deg from those stored"
    return largest <= SAME_MM_OR_DEG, found


def _derivatives(model: LaxityModel, stored: Laxity) -> tuple[bool, str]:
    residuals = LaxityResiduals(model=model, laxity=stored)
    theta = model.parameters.center
    exact = residuals.jacobian(theta)
    differences = exact * 0.0
    for i in range(len(theta)):
        up, down = theta.copy(), theta.copy()
        up[i] += STEP
        down[i] -= STEP
        differences[:, i] = (residuals.residuals(up) - residuals.residuals(down)) / (2.0 * STEP)
    share = float(abs(exact - differences).max() / abs(exact).max())
    found = f"exact ones are {share:.1g} of the largest from central differences"
    return share <= SAME_SLOPE, found


def _fit(model: LaxityModel, _: Laxity) -> tuple[bool, str]:
    full = model.with_protocol(load_protocol("seed63"))
    truth = full.parameters.center
    problem = LaxityResiduals(model=full, laxity=full.simulate(truth))
    ended = fit(problem, load_start("IG2", full.parameters))
    largest = float(abs(ended.theta - truth).max())
    found = f"from IG2 it ends {largest:.1g} kN or % from the parameters of its data"
    return largest <= SAME_KN_OR_PCT, found
