"""Where compiled code is kept."""

import os
import sys
from pathlib import Path

import pytest

from identknee.mechanics.compiled_folder import compiled_folder

MODULE = sys.modules[compiled_folder.__module__]


def test_code_is_kept_by_the_sources_content_place_and_age(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = compiled_folder()
    assert now == compiled_folder.__wrapped__()
    for source in Path(str(MODULE.__file__)).parent.glob("*.py"):
        (tmp_path / source.name).write_bytes(source.read_bytes())
    monkeypatch.setattr(MODULE, "__file__", str(tmp_path / "compiled_folder.py"))
    elsewhere = compiled_folder.__wrapped__()
    os.utime(tmp_path / "energy.py", (0.0, 0.0))
    older = compiled_folder.__wrapped__()
    (tmp_path / "energy.py").write_text("edited")
    os.utime(tmp_path / "energy.py", (0.0, 0.0))
    edited = compiled_folder.__wrapped__()
    assert len({now, elsewhere, older, edited}) == 4
