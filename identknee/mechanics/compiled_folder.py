"""Where compiled code is kept."""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

from identknee.runs.cache_folder import cache_folder


@cache
def compiled_folder() -> Path:
    """The folder of what was compiled from these sources.

    numba's own cache looks at one file only: a caller of an edited function in another file is not
    recompiled and may crash the interpreter. This folder's name is a digest of every source in this
    package, of where it lies and since when, which numba asks for as well, and of the versions
    involved, so an edit, an upgrade or another installation starts a fresh one.
    """
    versions = " ".join(f"{x} {version(x)}" for x in ("numba", "llvmlite", "numpy"))
    digest = hashlib.sha256(versions.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(f"{source} {source.stat().st_mtime_ns}".encode() + source.read_bytes())
    return cache_folder() / "compiled" / digest.hexdigest()[:16]
