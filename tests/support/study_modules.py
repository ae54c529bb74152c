"""Modules of a study, whose folders begin with a number and are no packages."""

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

STUDIES = Path(__file__).parents[2] / "studies"


def study_module(path: Path) -> ModuleType:
    """The module of a file, loaded anew."""
    spec = spec_from_file_location(f"study_{path.parent.name}_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
