"""What compiled functions are kept by."""

import sys
from pathlib import Path
from typing import Any

import pytest

from identknee.mechanics.elements import tension
from identknee.runs.compiling import compiled, compiled_folder


def test_functions_are_kept_where_their_sources_say() -> None:
    function: Any = tension
    package = Path(function.py_func.__code__.co_filename).parent
    assert Path(function.stats.cache_path).is_relative_to(compiled_folder(package))


def test_an_edit_of_any_source_starts_a_new_folder(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text("before")
    (tmp_path / "callee.py").write_text("before")
    before = compiled_folder.__wrapped__(tmp_path)
    assert compiled_folder.__wrapped__(tmp_path) == before
    (tmp_path / "callee.py").write_text("after")
    assert compiled_folder.__wrapped__(tmp_path) != before


def test_compiling_leaves_the_callers_settings_alone() -> None:
    numba = sys.modules["numba"]
    before = numba.config.CACHE_DIR
    compiled(lambda x: x)
    assert before == numba.config.CACHE_DIR


def test_without_a_place_to_keep_it_a_function_is_compiled_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    nowhere = tmp_path / "file" / "cache"
    monkeypatch.setattr("identknee.runs.compiling.compiled_folder", lambda _: nowhere)
    assert compiled(_doubled)(2.0) == 4.0


def _doubled(x: float) -> float:
    return 2.0 * x
