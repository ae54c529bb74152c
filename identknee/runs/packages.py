"""Public names that moved from ``identknee`` into its packages, for earlier scripts."""

import warnings
from collections.abc import Mapping
from types import ModuleType


def held_by_package(packages: Mapping[str, ModuleType], own: str, name: str) -> ModuleType | None:
    """The package that holds a public name, or None; it warns of the new place.

    Parameters
    ----------
    packages
        The packages by their names.
    own
        Name of the module from which the name was requested.
    name
        The name requested.
    """
    for place, package in packages.items():
        if name in dir(package) and not isinstance(getattr(package, name), ModuleType):
            said = f"{own}.{name} is now {own}.{place}.{name}"
            # Two frames above this one is the caller of ``identknee.__getattr__``.
            warnings.warn(said, DeprecationWarning, stacklevel=3)
            return package
    return None
