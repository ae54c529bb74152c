"""Cases of a test of which some run with ``--slow`` alone."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def some_slow(cases: Iterable[Any], slow: Collection[Any]) -> list[Any]:
    """The cases for `pytest.mark.parametrize`, those that are slow marked as such."""
    return [pytest.param(x, marks=pytest.mark.slow) if x in slow else x for x in cases]
