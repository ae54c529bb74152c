"""Outcomes of long runs, kept one by one in the folder of temporary files so that runs resume."""

import json
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any


class KeptOutcomes:
    """The outcomes of one verification, by the key of their task."""

    def __init__(self, name: str) -> None:
        self._file = Path(tempfile.gettempdir()) / "identknee_verification" / f"{name}.jsonl"

    def known(self) -> dict[str, dict[str, Any]]:
        """What is kept."""
        lines = self._file.read_text(encoding="utf-8").splitlines() if self._file.exists() else []
        return {x["key"]: x for x in map(json.loads, lines)}

    def keep(self, key: str, outcome: Mapping[str, Any]) -> None:
        """Add one to what is kept."""
        self._file.parent.mkdir(exist_ok=True)
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps({**outcome, "key": key}) + "\n")

    def compute(self, tasks: Mapping[str, Callable[[], Mapping[str, Any]]], workers: int) -> None:
        """Compute in processes and keep what is not kept yet."""
        known = self.known()
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as executor:
            running = {executor.submit(x): key for key, x in tasks.items() if key not in known}
            for done in as_completed(running):
                self.keep(running[done], done.result())
