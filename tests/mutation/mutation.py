"""A fault put into the package by hand, and the tests that must go red with it."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """A fault.

    Attributes
    ----------
    file
        Of the package, from the root of the repository.
    where
        Function, method or class that holds the place, such as ``Knee.mirrored``; empty for the
        module.
    old, new
        An expression, or statements that follow one another, and what takes their place. The place
        is found by its syntax tree: formatting and comments do not matter, and a file may move.
    why
        What a user would get from it.
    tests
        Tests of which at least one must fail, as pytest takes them.
    """

    file: str
    where: str
    old: str
    new: str
    why: str
    tests: tuple[str, ...]

    @property
    def name(self) -> str:
        """What tells it from others."""
        return f"{self.where or 'module'}: {self.old.strip()} -> {self.new.strip()}"

    def applied(self, text: str) -> str:
        """The text of the file with the fault.

        Raises
        ------
        ValueError
            If the place is not there, or there more than once.
        """
        scope = _named(ast.parse(text), self.where)
        is_value = _is_expression(self.old) and _is_expression(self.new)
        places = [] if scope is None else [*_places(scope, self.old, is_value=is_value)]
        if len(places) != 1:
            raise ValueError(
                f"{self.file} holds {self.old!r} {len(places)} times in {self.where or 'module'}; "
                "a mutation needs one place"
            )
        first, last = places[0]
        raw = text.encode()
        lines = [0, *accumulate(len(x) for x in raw.splitlines(keepends=True))]
        begin = lines[first.lineno - 1] + first.col_offset
        end = lines[(last.end_lineno or 0) - 1] + (last.end_col_offset or 0)
        indent = "\n" + " " * first.col_offset
        new = f"({self.new})" if isinstance(first, ast.expr) else self.new.replace("\n", indent)
        return (raw[:begin] + new.encode() + raw[end:]).decode()


def fault(file: str, where: str, old: str, new: str, why: str, *tests: str) -> Mutation:
    """The same, its fields by their order."""
    return Mutation(file=file, where=where, old=old, new=new, why=why, tests=tests)


def _named(tree: ast.Module, where: str) -> ast.AST | None:
    """The definition called ``Class.method`` or ``function``."""
    scope: ast.AST | None = tree
    for name in where.split(".") if where else ():
        found = (x for x in ast.walk(scope or tree) if getattr(x, "name", None) == name)
        scope = next((x for x in found if isinstance(x, ast.FunctionDef | ast.ClassDef)), None)
    return scope


def _is_expression(code: str) -> bool:
    body = ast.parse(code).body
    return len(body) == 1 and isinstance(body[0], ast.Expr)


def _places(
    scope: ast.AST, pattern: str, *, is_value: bool
) -> Iterator[tuple[ast.expr | ast.stmt, ...]]:
    """First and last node of every place that reads as the pattern."""
    wanted = ast.parse(pattern).body
    if is_value:
        same = ast.dump(ast.parse(pattern, mode="eval").body)
        for node in ast.walk(scope):
            if isinstance(node, ast.expr) and ast.dump(node) == same:
                yield node, node
        return
    trees = [ast.dump(x) for x in wanted]
    for node in ast.walk(scope):
        for body in (getattr(node, x, None) for x in ("body", "orelse", "finalbody")):
            statements = body if isinstance(body, list) else []
            dumps = [ast.dump(x) for x in statements]
            for i in range(len(dumps) - len(trees) + 1):
                if dumps[i : i + len(trees)] == trees:
                    yield statements[i], statements[i + len(trees) - 1]
