"""Where compiled code is kept."""

import sys
from pathlib import Path
from typing import Any

import pytest

from identknee.mechanics import compiled
from identknee.mechanics.ligament_law import tension


def test_the_cache_is_where_the_environment_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IDENTKNEE_CACHE", str(tmp_path))
    assert compiled.cache_folder.__wrapped__() == tmp_path
    monkeypatch.delenv("IDENTKNEE_CACHE")
    assert compiled.cache_folder.__wrapped__().name == "identknee"


def test_compiled_code_is_kept_by_the_sources_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = compiled._compiled_folder()
    function: Any = tension
    assert now == compiled._compiled_folder.__wrapped__()
    assert Path(function.stats.cache_path).is_relative_to(now)
    for source in Path(compiled.__file__).parent.glob("*.py"):
        (tmp_path / source.name).write_bytes(source.read_bytes())
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    assert compiled._compiled_folder.__wrapped__() == now
    (tmp_path / "energy.py").write_text("edited")
    assert compiled._compiled_folder.__wrapped__() != now


def test_compiling_leaves_the_callers_settings_alone() -> None:
    numba = sys.modules["numba"]
    before = numba.config.CACHE_DIR
    compiled.compiled(lambda x: x)
    assert before == numba.config.CACHE_DIR
