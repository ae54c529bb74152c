"""What the page of the paper takes from other studies: their records and their modules."""

import json
import sys
from collections.abc import Mapping
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

STUDIES = Path(__file__).parents[1]
Row = Mapping[str, Any]


def record_of(study: str) -> Row | None:
    """The record of a study; None where it has not been computed yet."""
    for path in sorted((STUDIES / study / "records").glob("*.json")):
        record: Row = json.loads(path.read_text(encoding="utf-8"))
        return record
    return None


def module_of(study: str, name: str) -> ModuleType:
    """A module of a study, whose name alone would not tell it from another study's.

    Raises
    ------
    ModuleNotFoundError
        If there is none.
    """
    known = f"study_{study}_{name}"
    if known in sys.modules:
        return sys.modules[known]
    spec = spec_from_file_location(known, STUDIES / study / f"{name}.py")
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"study {study} has no module {name}")
    module = module_from_spec(spec)
    sys.modules[known] = module
    spec.loader.exec_module(module)
    return module
