"""A page for each package with all that is public in it, and one with the names of the root."""

from importlib import import_module
from pathlib import Path
from typing import Any

import identknee as ik

ROOT = Path(ik.__file__).parent
# In the order of the flow; the command line has a page of its own.
PACKAGES = (
    *("subject", "laxity", "model", "calibrate", "identify", "checks", "diagnosis"),
    *("verbs", "report", "blind", "blind_test", "mechanics", "runs"),
)


def write_api(folder: Path) -> None:
    """Write the pages of the Python interface."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "index.rst").write_text(index_page(), encoding="utf-8")
    for package in PACKAGES:
        (folder / f"{package}.rst").write_text(package_page(package), encoding="utf-8")


def index_page() -> str:
    """The names of the root in the order of the flow, then the pages of the packages."""
    names = "\n".join(_names(package, ik) for package in PACKAGES)
    pages = "\n".join(f"   {package}" for package in PACKAGES)
    return (
        f"{title('Python interface', '=')}"
        "``import identknee as ik`` gives these names, in the order of the flow, and the packages\n"
        "below with more of them: ``ik.identify.geodesics``. The pages of the packages hold all\n"
        "with arrays' shapes, units, errors and sources, and what they are made of.\n\n"
        f".. autosummary::\n\n{names}\n\n"
        f".. toctree::\n   :maxdepth: 1\n   :caption: Packages\n\n{pages}\n"
    )


def _names(package: str, place: Any) -> str:
    """Entries of a summary: what a place has of a package, in the order of its modules."""
    values = [(name, getattr(place, name)) for name in dir(place)]
    homes = [(getattr(value, "__module__", ""), name) for name, value in values]
    start = f"identknee.{package}."
    return "\n".join(f"   ~{home}.{x}" for home, x in sorted(homes) if home.startswith(start))


def package_page(package: str) -> str:
    """The names of a package, and all modules of it, those in its subpackages included."""
    own = f"identknee.{package}"
    parts = [title(own, "="), f".. automodule:: {own}\n\n"]
    place = import_module(own)
    if names := _names(package, place) if "attach_stub" in vars(place) else "":
        parts += [f"``ik.{package}`` has these names beside those of the root.\n\n"]
        # Whole paths are meant from nowhere, which keeps them short on the page.
        parts += [f".. currentmodule:: None\n\n.. autosummary::\n\n{names}\n\n"]
    for path in sorted((ROOT / package).rglob("*.py")):
        module = ".".join(path.relative_to(ROOT.parent).with_suffix("").parts)
        if path.name == "__init__.py":
            continue
        parts += [title(module.removeprefix(own + "."), "-")]
        parts += [f".. automodule:: {module}\n   :members:\n\n"]
    return "".join(parts)


def title(text: str, line: str) -> str:
    """A heading in reStructuredText."""
    return f"{text}\n{line * len(text)}\n\n"
