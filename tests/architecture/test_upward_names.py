"""Nothing below names what stands above it, not even as text that is imported later."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import package_trees
import pytest
from package_trees import ROOT, nodes_of, tree_of

MODULES = [x for x in package_trees.MODULES if x.parent != ROOT]
PLACE = re.compile(r"identknee\.(\w+)(?:[.:][\w.:]*)?")
# An optional package of others.
IMPORTED_BY_NAME = {"calibrate/population.py": "module"}


def layers() -> list[str]:
    """The packages, the highest first."""
    settings = tomllib.loads((ROOT.parent / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    whole = next(x for x in contracts if x.get("containers") == ["identknee"])
    return list(whole["layers"])


def height(package: str) -> int:
    """How far down a package stands; packages side by side stand equally far."""
    return next(k for k, x in enumerate(layers()) if package in re.split(r"\W+", x))


def texts(tree: ast.Module) -> Iterator[str]:
    """Strings of the code that are no docstrings."""
    described = ast.Module | ast.ClassDef | ast.FunctionDef
    docs = {
        id(x.body[0].value)
        for x in ast.walk(tree)
        if isinstance(x, described) and x.body and isinstance(x.body[0], ast.Expr)
    }
    for x in ast.walk(tree):
        if isinstance(x, ast.Constant) and isinstance(x.value, str) and id(x) not in docs:
            yield x.value


@pytest.mark.skipif(
    not (ROOT.parent / "pyproject.toml").exists(), reason="an installed package has no layers"
)
@pytest.mark.parametrize("path", MODULES, ids=lambda x: x.relative_to(ROOT).as_posix())
def test_no_text_is_the_name_of_something_above(path: Path) -> None:
    own = height(path.relative_to(ROOT).parts[0])
    named = [x[1] for text in texts(tree_of(path)) if (x := PLACE.fullmatch(text))]
    packages = [x for x in named if (ROOT / x).is_dir()]
    assert [x for x in packages if height(x) < own] == []


def test_modules_of_the_package_are_not_imported_by_name() -> None:
    found = {}
    for path in MODULES:
        for x in nodes_of(path):
            if isinstance(x, ast.Call) and "import_module" in ast.unparse(x.func):
                found[path.relative_to(ROOT).as_posix()] = ast.unparse(x.args[0])
    assert found == IMPORTED_BY_NAME
