"""The generator of blind data shares no code with the model, but for what both are given."""

import ast
from functools import cache
from pathlib import Path

import pytest
from package_trees import ROOT, nodes_of

SHARED = {"subject", "laxity", "runs"}
TESTED = ("mechanics", "model", "calibrate", "identify", "checks", "diagnosis", "verbs", "report")


@cache
def _imports(path: Path) -> set[str]:
    """Modules of identknee that a file imports, at its top or inside a function."""
    found: set[str] = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {x for x in found if x.startswith("identknee")}


def _module(name: str) -> Path | None:
    path = ROOT.parent / Path(*name.split("."))
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.exists():
            return candidate
    return None


def _reached(package: str) -> set[str]:
    """Every module of identknee that a package's modules lead to."""
    if not (ROOT / package / "__init__.py").exists():
        raise FileNotFoundError(f"no package identknee.{package}: a check of nothing would pass")
    reached: set[str] = set()
    waiting = {
        f"identknee.{x.relative_to(ROOT).with_suffix('').as_posix().replace('/', '.')}"
        for x in (ROOT / package).rglob("*.py")
    }
    while waiting:
        name = waiting.pop().removesuffix(".__init__")
        path = _module(name)
        if name not in reached and path is not None:
            reached.add(name)
            waiting |= _imports(path)
    return reached


def _part(module: str) -> str:
    return (*module.split("."), "")[1]


def test_the_generator_imports_what_it_may() -> None:
    direct = set().union(*(_imports(x) for x in (ROOT / "blind").rglob("*.py")))
    assert {_part(x) for x in direct} <= SHARED | {"blind"}


def test_nothing_tested_imports_the_generator() -> None:
    for package in TESTED:
        assert not [x for x in _reached(package) if _part(x) == "blind"]


def test_both_share_what_they_are_given_and_nothing_else() -> None:
    generator = _reached("blind")
    for package in ("model", "diagnosis"):
        common = generator & _reached(package)
        assert {_part(x) for x in common} <= SHARED


def test_every_package_is_there_to_be_checked() -> None:
    """Of `TESTED` none is misspelt, and only those that use the generator are left out."""
    there = {x.parent.name for x in ROOT.glob("*/__init__.py")}
    assert there == {*TESTED, *SHARED, "blind", "blind_test", "cli"}
    with pytest.raises(FileNotFoundError, match="diagnose"):
        _reached("diagnose")
