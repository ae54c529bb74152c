"""`identknee doctor`: whether this installation is sound, and what to do where it is not."""

import os
import platform
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution, version
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any

import typer
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import identknee as ik
from identknee.cli.command import show, timed
from identknee.runs.errors import NotComputed
from identknee.runs.files import BYTES_PER_MB, prepare_folder
from identknee.runs.library_threads import LIBRARY_THREADS
from identknee.runs.progress import progress_bar

# Extras for work on identknee itself; a user misses nothing without them.
FOR_DEVELOPERS = {"benchmarks", "docs", "lint", "test"}
# Numbers of the same program on another machine: rounding may differ, nothing else.
SAME_MM_OR_DEG = 1e-6
# Half the step of a central difference [kN and %], and what it can be trusted to, as a share of
# the largest derivative.
STEP, SAME_SLOPE = 1e-3, 1e-4
# Where least squares stops on data without noise.
SAME_KN_OR_PCT = 1e-6
INSTALL_AGAIN = "Install it again from its checkout: pip install --force-reinstall ."

Json = Annotated[bool, typer.Option("--json", help="Print the checks as JSON, and nothing else.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One thing looked at.

    Attributes
    ----------
    group
        What it belongs to: versions, machine, cache, extras or self-test.
    name
        What it is.
    is_sound
        Whether it is as it should be; an extra may be missing and still be so.
    found
        What was found.
    remedy
        What to do about it, a sentence; empty where there is nothing to do.
    """

    group: str
    name: str
    is_sound: bool
    found: str
    remedy: str = ""

    def line(self) -> str:
        """The check as a line for a person."""
        mark = "  ok  " if self.is_sound else "  FAIL"
        text = f"{mark}  {self.name}: {self.found}"
        return f"{text}. {self.remedy}" if self.remedy else text


def doctor(as_json: Json = False) -> None:
    """Check this installation: versions, cores, cache, extras and a short self-test.

    The self-test repeats known trials of the reference knee. The first one after an
    installation compiles, which takes up to a minute. The exit code is 1 if anything is wrong.
    """
    checks: list[Check] = []
    for part in (versions, machine, cache, extras, self_test):
        checks += part()
    failed = [x.name for x in checks if not x.is_sound]
    summary = {
        "is_sound": not failed,
        "checks": [
            {name: getattr(x, name) for name in ("group", "name", "is_sound", "found", "remedy")}
            for x in checks
        ],
    }
    show(summary, _lines(checks), as_json=as_json)
    if failed:
        raise NotComputed(
            f"{len(failed)} of {len(checks)} checks failed ({', '.join(failed)}). "
            "Do what their lines say, then run again: identknee doctor"
        )


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
    try:
        from identknee.mechanics.compiled import cache_folder
    except ImportError:  # Which package it is stands among the versions.
        return
    folder = cache_folder()
    try:
        prepare_folder(folder)
    except ik.InputError as error:
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
        with progress_bar("preparing, longer the first time after an installation"):
            with as_file(files("identknee.cli").joinpath("self_test.csv")) as path:
                stored = ik.read_laxity(path)
            model = ik.LaxityModel(knee=ik.reference_knee(), protocol=stored.protocol)
            model.predict(model.parameters.center)
        for name, test in (
            ("poses", _poses),
            ("derivatives", _derivatives),
            ("fit", _fit),
        ):
            yield _timed_check(name, test, model, stored)
    # A broken installation may raise anything, and what it is is the answer.
    except Exception as error:  # noqa: BLE001
        found = f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(".")
        yield Check(
            group="self-test", name="run", is_sound=False, found=found, remedy=INSTALL_AGAIN
        )


def _timed_check(
    name: str,
    test: "Callable[[ik.LaxityModel, ik.Laxity], tuple[bool, str]]",
    model: "ik.LaxityModel",
    stored: "ik.Laxity",
) -> Check:
    (is_sound, found), seconds = timed(lambda: test(model, stored))
    return Check(
        group="self-test",
        name=name,
        is_sound=is_sound,
        found=f"{found} ({seconds:.2f} s)",
        remedy="" if is_sound else f"Trust no result of this installation. {INSTALL_AGAIN}",
    )


def _poses(model: "ik.LaxityModel", stored: "ik.Laxity") -> tuple[bool, str]:
    difference = abs(model.simulate(model.parameters.center).coordinates - stored.coordinates)
    largest = float(difference.max())
    found = f"{stored.n} trials of the reference knee are {largest:.1g} mm or deg from those stored"
    return largest <= SAME_MM_OR_DEG, found


def _derivatives(model: "ik.LaxityModel", stored: "ik.Laxity") -> tuple[bool, str]:
    residuals = ik.LaxityResiduals(model=model, laxity=stored)
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


def _fit(model: "ik.LaxityModel", _: "ik.Laxity") -> tuple[bool, str]:
    from identknee.calibrate.fit import fit

    full = model.with_protocol(ik.load_protocol("seed63"))
    truth = full.parameters.center
    problem = ik.LaxityResiduals(model=full, laxity=full.simulate(truth))
    ended = fit(problem, ik.load_start("IG2", full.parameters))
    largest = float(abs(ended.theta - truth).max())
    found = f"from IG2 it ends {largest:.1g} kN or % from the parameters of its data"
    return largest <= SAME_KN_OR_PCT, found


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
    """How many functions that Python calls are kept compiled for this version of the sources."""
    from identknee.mechanics.small_matrices import scale_of

    dispatcher: Any = scale_of
    kept_at = dispatcher.stats.cache_path
    return len(list(Path(kept_at).parent.glob("*.done"))) if kept_at else 0


def _lines(checks: list[Check]) -> list[str]:
    lines: list[str] = []
    for i, check in enumerate(checks):
        if not i or check.group != checks[i - 1].group:
            lines.append(check.group.capitalize())
        lines.append(check.line())
    if all(x.is_sound for x in checks):
        lines.append("All is as it should be.")
    return lines
