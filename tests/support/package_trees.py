"""The modules of the package and what they hold."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import identknee

ROOT = Path(identknee.__file__).parent
MODULES = sorted(ROOT.rglob("*.py"))


@cache
def tree_of(path: Path) -> ast.Module:
    """The tree of a module, read once for all tests."""
    return ast.parse(path.read_text(encoding="utf-8"))


def nodes_of(path: Path) -> Iterator[ast.AST]:
    """Everything in the tree of a module."""
    return ast.walk(tree_of(path))
