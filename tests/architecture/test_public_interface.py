"""The public names: one list in each stub, loaded when used."""

import re
import subprocess
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType, ModuleType

import pytest

import identknee as ik

HEAVY = ("numba", "scipy", "matplotlib", "xarray", "trimesh", "pandas", "rich")


PACKAGES = [name for name in dir(ik) if isinstance(getattr(ik, name), ModuleType)]
MOST = 50
STUB = Path(ik.__file__).with_suffix(".pyi")


def _names() -> list[tuple[ModuleType, str]]:
    """Every public name that is no package, with what it is a name of."""
    places = [ik, *(getattr(ik, package) for package in PACKAGES)]
    return [(place, name) for place in places for name in dir(place) if name not in PACKAGES]


def test_the_front_door_is_one_page_and_shows_nothing_else() -> None:
    assert len(dir(ik)) - len(PACKAGES) <= MOST
    imported = re.findall(r"^from \.\S* import (\w+) as \1$", STUB.read_text("utf-8"), re.MULTILINE)
    assert sorted(imported) == dir(ik)


@pytest.mark.parametrize(("place", "name"), _names(), ids=lambda x: getattr(x, "__name__", x))
def test_every_public_name_is_there_once_and_explained(place: ModuleType, name: str) -> None:
    value = getattr(place, name)
    if isinstance(value, type | FunctionType):
        assert value.__doc__
        assert value.__module__.startswith("identknee.")
    # A module of the same name would take its place as soon as something imports it.
    assert find_spec(f"{place.__name__}.{name}") is None
    assert sum(other == name for _, other in _names()) == 1


def test_the_version_is_that_of_the_installed_package() -> None:
    assert ik.__version__ == version("identknee")


def test_other_names_are_missed_in_the_usual_way() -> None:
    with pytest.raises(AttributeError, match="sweeep"):
        _ = ik.sweeep  # type: ignore[attr-defined]


def test_names_of_earlier_versions_are_found_in_their_package() -> None:
    with pytest.warns(DeprecationWarning, match=r"identknee\.model\.Parameters") as caught:
        assert ik.Parameters is ik.model.Parameters  # type: ignore[attr-defined]
    assert caught[0].filename == __file__
    assert "Parameters" not in dir(ik)


@pytest.mark.parametrize("module", ["identknee", "identknee.cli.app"])
def test_a_start_loads_nothing_heavy(module: str) -> None:
    code = f"import {module}, sys; print([x for x in {HEAVY} if x in sys.modules])"
    answer = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert answer.stdout.strip() == "[]"
