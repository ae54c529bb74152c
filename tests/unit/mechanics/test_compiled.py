"""Where compiled code is kept."""

import json
import os
import subprocess
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


def test_compiled_code_is_kept_by_the_sources_content_place_and_age(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = compiled._compiled_folder()
    function: Any = tension
    assert now == compiled._compiled_folder.__wrapped__()
    assert Path(function.stats.cache_path).is_relative_to(now)
    for source in Path(compiled.__file__).parent.glob("*.py"):
        (tmp_path / source.name).write_bytes(source.read_bytes())
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    elsewhere = compiled._compiled_folder.__wrapped__()
    os.utime(tmp_path / "energy.py", (0.0, 0.0))
    older = compiled._compiled_folder.__wrapped__()
    (tmp_path / "energy.py").write_text("edited")
    os.utime(tmp_path / "energy.py", (0.0, 0.0))
    edited = compiled._compiled_folder.__wrapped__()
    assert len({now, elsewhere, older, edited}) == 4


def test_compiling_leaves_the_callers_settings_alone() -> None:
    numba = sys.modules["numba"]
    before = numba.config.CACHE_DIR
    compiled.compiled(lambda x: x)
    assert before == numba.config.CACHE_DIR


TOY = """
import json
import numpy as np
from identknee.mechanics.compiled import compiled, compiled_apart

@compiled
def inner(x):
    return x * x

@compiled_apart
def outer(values):
    total = 0.0
    for x in values:
        total += inner(x)
    return total
"""
RUN = """
import json, numpy as np, toy
value = toy.outer(np.arange(5.0))
stats = toy.outer.compile.__self__.stats
hits, misses = sum(stats.cache_hits.values()), sum(stats.cache_misses.values())
print(json.dumps([value, hits, misses]))
"""


def _run_toy(folder: Path, cache: str) -> list[float]:
    (folder / "toy.py").write_text(TOY)
    path = os.pathsep.join([str(folder), str(Path(__file__).parents[3])])
    answer = subprocess.run(
        [sys.executable, "-c", RUN],
        env={**os.environ, "PYTHONPATH": path, "IDENTKNEE_CACHE": cache},
        check=True,
        capture_output=True,
    )
    found: list[float] = json.loads(answer.stdout)
    return found


def test_the_first_process_loads_compiled_code_as_later_ones_do(tmp_path: Path) -> None:
    """Code just compiled gives other last bits than the same code loaded."""
    loaded = [30.0, 1, 0]
    assert _run_toy(tmp_path, str(tmp_path / "cache")) == loaded
    assert _run_toy(tmp_path, str(tmp_path / "cache")) == loaded


def test_without_a_cache_every_process_compiles(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert _run_toy(tmp_path, str(tmp_path / "file" / "cache"))[0] == 30.0
