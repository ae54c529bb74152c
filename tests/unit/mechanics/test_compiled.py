"""What the decorators do to functions."""

import sys
from pathlib import Path
from typing import Any

from identknee.mechanics import compiled
from identknee.mechanics.compiled_folder import compiled_folder
from identknee.mechanics.ligament_law import tension


def test_parts_are_kept_where_the_whole_is() -> None:
    function: Any = tension
    assert Path(function.stats.cache_path).is_relative_to(compiled_folder())


def test_compiling_leaves_the_callers_settings_alone() -> None:
    numba = sys.modules["numba"]
    before = numba.config.CACHE_DIR
    compiled.compiled(lambda x: x)
    assert before == numba.config.CACHE_DIR
