"""Files that tests compare with; ``tests/data/README.md`` says what each is."""

import json
from pathlib import Path
from typing import Any

DATA = Path(__file__).parents[1] / "data"


def stored(name: str) -> dict[str, Any]:
    """Content of a JSON file of the folder ``data``."""
    content: dict[str, Any] = json.loads((DATA / name).read_text(encoding="utf-8"))
    return content
