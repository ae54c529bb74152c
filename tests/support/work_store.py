"""Where a long verification keeps what is finished until its row is written."""

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from identknee.runs.store import Store, open_work


@contextmanager
def work_store(name: str, about: Mapping[str, Any]) -> Iterator[Store]:
    """Store under the system's folder of temporary files, removed once all went well."""
    path = Path(tempfile.gettempdir()) / "identknee_verification" / f"{name}.sqlite"
    with open_work(path, about) as store:
        yield store
    for left in path.parent.glob(f"{path.name}*"):
        left.unlink()
