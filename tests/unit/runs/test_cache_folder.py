"""Where everything is kept that can be computed again."""

from pathlib import Path

import pytest

from identknee.runs.files import cache_folder


def test_the_cache_is_where_the_environment_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IDENTKNEE_CACHE", str(tmp_path))
    assert cache_folder.__wrapped__() == tmp_path
    monkeypatch.delenv("IDENTKNEE_CACHE")
    assert cache_folder.__wrapped__().name == "identknee"
