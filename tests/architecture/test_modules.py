"""Modules are small and import no more than their part needs."""

import ast
import builtins
import re
import subprocess
import sys
from pathlib import Path

import pytest
from package_trees import MODULES, ROOT, nodes_of, tree_of

MOST_LINES, MOST_LINES_OF_FUNCTION = 1000, 100
# Longer, each for its reason.
LONG_MODULES: dict[str, str] = {}
ATTACHED = [
    "from lazy_loader import attach_stub",
    "__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)",
]
LONG_FUNCTIONS: dict[str, str] = {}


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_no_module_is_long_without_a_reason() -> None:
    lengths = {_name(x): len(x.read_text(encoding="utf-8").splitlines()) for x in MODULES}
    long = {name for name, length in lengths.items() if length > MOST_LINES}
    assert long == set(LONG_MODULES)


def test_no_function_is_long_without_a_reason() -> None:
    """From its name to its last line, docstring left out."""
    long = set()
    for path in MODULES:
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                first = node.body[1 if ast.get_docstring(node) and len(node.body) > 1 else 0]
                if (node.end_lineno or 0) - first.lineno + 1 > MOST_LINES_OF_FUNCTION:
                    long.add(f"{_name(path)}:{node.name}")
    assert long == set(LONG_FUNCTIONS)


def test_docstrings_name_errors_that_exist() -> None:
    nodes = [(path, node) for path in MODULES for node in nodes_of(path)]
    known = {node.name for _, node in nodes if isinstance(node, ast.ClassDef)} | set(dir(builtins))
    unknown = set()
    for path, node in nodes:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            section = re.search(
                r"^Raises\n-+\n(.*?)(?=\n\n\w+\n-+\n|\Z)",
                ast.get_docstring(node) or "",
                re.MULTILINE | re.DOTALL,
            )
            names = re.findall(r"^\S.*$", section[1], re.MULTILINE) if section else []
            errors = {x.rpartition(".")[2] for line in names for x in line.split(", ")}
            unknown |= {f"{_name(path)}:{node.name}: {x}" for x in errors - known}
    assert unknown == set()


@pytest.mark.parametrize("path", [x for x in MODULES if x.name == "__init__.py"], ids=_name)
def test_packages_hold_their_docstring_and_at_most_a_stub(path: Path) -> None:
    """The names of a package stand in its stub alone."""
    if path.parent != ROOT:
        names = [ast.unparse(x) for x in tree_of(path).body[1:]]
        if path.parent.name == "report":  # a package that is also called, as `ik.report`
            names = [x for x in names if x in ATTACHED]
        assert names == (ATTACHED if path.with_suffix(".pyi").exists() else [])


def test_no_module_has_a_name_that_says_nothing() -> None:
    stems = {x.stem for x in MODULES}
    assert not stems & {"utils", "util", "helpers", "common", "misc", "constants", "base"}


def test_plotting_is_imported_by_the_report_alone() -> None:
    """Not even through another module: a program that fits needs no figures."""
    parts = ("runs", "mechanics", "subject", "laxity", "model", "calibrate")
    modules = [
        f"identknee.{_name(x)[:-3].replace('/', '.').removesuffix('.__init__')}"
        for x in MODULES
        if x.relative_to(ROOT).parts[0] in parts
    ]
    code = (
        f"import importlib, sys\nfor x in {modules}: importlib.import_module(x)\n"
        "print([x for x in ('matplotlib', 'plotly', 'identknee.report') if x in sys.modules])"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert answer.stdout.strip() == "[]"


def test_names_of_test_files_differ() -> None:
    """There are no packages among the tests, so two of one name would hide one another."""
    names = [x.name for x in Path(__file__).parents[1].rglob("*.py")]
    assert sorted(names) == sorted(set(names))


def test_nothing_names_the_place_it_was_written_at() -> None:
    root = ROOT.parent
    folders = [ROOT, *(root / x for x in ("tests", "studies", "docs"))]
    files = [x for folder in folders for x in folder.rglob("*.py")]
    place = str(root) + "/"
    assert [str(x) for x in files if place in x.read_text(encoding="utf-8")] == []
