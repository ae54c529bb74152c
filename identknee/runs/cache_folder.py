"""Where everything is kept that can be computed again."""

import os
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path


@cache
def cache_folder() -> Path:
    """The folder for everything that can be computed again, ``IDENTKNEE_CACHE`` if that is set."""
    return Path(os.environ.get("IDENTKNEE_CACHE") or user_cache_path("identknee"))
