"""Names of the front door that a package holds now: scripts of earlier versions still run."""

import warnings
from collections.abc import Mapping
from types import ModuleType


def held_by_package(packages: Mapping[str, ModuleType], own: str, name: str) -> ModuleType | None:
    """The package that has a public name; None where none has. It warns of the place.

    Parameters
    ----------
    packages
        The packages by their names.
    own
        The module of which the name was asked.
    name
        What was asked for.
    """
    for place, package in packages.items():
        if name in dir(package) and not isinstance(getattr(package, name), ModuleType):
            said = f"{own}.{name} is now {own}.{place}.{name}"
            # Above this are the front door and whoever asked it.
            warnings.warn(said, DeprecationWarning, stacklevel=3)
            return package
    return None
