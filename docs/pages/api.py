"""A page for each package with all that is public in it, and one with the names of the root."""

from pathlib import Path

import identknee as ik

ROOT = Path(ik.__file__).parent
# In the order of the flow; the command line has a page of its own.
PACKAGES = (
    *("subject", "laxity", "model", "calibrate", "identify", "diagnosis"),
    *("verbs", "report", "blind", "mechanics", "runs"),
)


def write_api(folder: Path) -> None:
    """Write the pages of the Python interface."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "index.rst").write_text(index_page(), encoding="utf-8")
    for package in PACKAGES:
        (folder / f"{package}.rst").write_text(package_page(package), encoding="utf-8")


def index_page() -> str:
    """The public names in the order of the flow, then the pages of the packages."""
    homes = [(getattr(ik, name).__module__, name) for name in ik.__all__]
    names = "\n".join(f"   ~{module}.{name}" for module, name in homes)
    pages = "\n".join(f"   {package}" for package in PACKAGES)
    return (
        f"{title('Python interface', '=')}"
        "``import identknee as ik`` gives these names, in the order of the flow. The pages of\n"
        "the packages hold them with arrays' shapes, units, errors and sources, and what they\n"
        "are made of.\n\n"
        f".. autosummary::\n\n{names}\n\n"
        f".. toctree::\n   :maxdepth: 1\n   :caption: Packages\n\n{pages}\n"
    )


def package_page(package: str) -> str:
    """All modules of a package, those in its subpackages included."""
    own = f"identknee.{package}"
    parts = [title(own, "="), f".. automodule:: {own}\n\n"]
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
