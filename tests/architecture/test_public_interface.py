"""The public names: one explicit list, loaded when used."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import identknee as ik

HEAVY = ("numba", "scipy", "matplotlib", "xarray", "trimesh", "pandas", "rich")


def _imported_for_types() -> set[str]:
    tree = ast.parse(Path(ik.__file__).read_text(encoding="utf-8"))
    found = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {name.name for node in found for name in node.names} - {"TYPE_CHECKING", "Any"}


def test_the_list_the_types_and_the_table_agree() -> None:
    assert len(ik.__all__) == len(set(ik.__all__))
    assert set(ik.__all__) == set(ik._HOMES) == _imported_for_types()


@pytest.mark.parametrize("name", ik.__all__)
def test_every_public_name_is_there_with_a_docstring(name: str) -> None:
    value = getattr(ik, name)
    assert value.__doc__
    assert value.__module__.startswith("identknee.")


def test_other_names_are_missed_in_the_usual_way() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'sweeep'"):
        _ = ik.sweeep
    assert set(ik.__all__) <= set(dir(ik))


@pytest.mark.parametrize("module", ["identknee", "identknee.cli.app"])
def test_a_start_loads_nothing_heavy(module: str) -> None:
    code = f"import {module}, sys; print([x for x in {HEAVY} if x in sys.modules])"
    answer = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert answer.stdout.strip() == "[]"
