"""A page a study: its README, with the figures drawn anew from the record it committed."""

import multiprocessing
import re
import runpy
import shutil
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

PICTURE = re.compile(r"!\[([^\]]*)\]\((figures/[^)]+)\)")
RECORD = re.compile(r"\[([^\]]*)\]\((records/[^)]+)\)")


def write_studies(folder: Path, studies: Path) -> None:
    """Write the pages of all studies and their list."""
    pages = sorted(studies.glob("[0-9]*/README.md"))
    for page in pages:
        _write_study(folder / page.parent.name, page.parent)
    names = "\n".join(f"{page.parent.name}/README" for page in pages)
    (folder / "index.md").write_text(
        "# Studies\n\nOne question each, answered by a slow `compute.py` that leaves a record; the "
        "figures here are drawn from\nthe records while the documentation is built.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{names}\n```\n",
        encoding="utf-8",
    )


def _write_study(target: Path, study: Path) -> None:
    # Drawn again only when something it hangs on has changed.
    made = target / "README.md"
    sources = [x for x in study.rglob("*") if x.is_file() and "__pycache__" not in x.parts]
    if made.exists() and made.stat().st_mtime > max(x.stat().st_mtime for x in sources):
        return
    # Under its own name only when it is whole.
    part = target.with_name(target.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    shutil.rmtree(target, ignore_errors=True)
    _fill(part, study)
    part.rename(target)


def _fill(target: Path, study: Path) -> None:
    target.mkdir(parents=True)
    made = target / "README.md"
    for name in ("README.md", "figures", "records"):
        if (study / name).is_dir():
            shutil.copytree(study / name, target / name)
        elif (study / name).exists():
            shutil.copy(study / name, target / name)
    # A study that has no figures yet is not finished; of a finished one the figures must be drawn.
    if any((target / "figures").glob("*.png")):
        _draw(study / "figures.py", "--out", str(target / "figures"), "--page", str(made))
    text = made.read_text(encoding="utf-8")
    text = PICTURE.sub(lambda x: x[0] if (target / x[2]).exists() else _missing(x[1]), text)
    text = RECORD.sub(lambda x: x[0] if (target / x[2]).exists() else f"`{x[2]}`", text)
    made.write_text(text, encoding="utf-8")


def _draw(script: Path, *options: str) -> None:
    # A copy of this process has what every script imports, which takes longer than its figures.
    for name in ("identknee.report.comparison", "matplotlib.figure", "scipy.stats"):
        import_module(name)
    method = "fork" if "fork" in multiprocessing.get_all_start_methods() else None
    made = multiprocessing.get_context(method).Process(target=_run, args=(script, options))
    made.start()
    made.join()
    if made.exitcode:
        raise RuntimeError(f"{script} ended with {made.exitcode}")


def _run(script: Path, options: Sequence[str]) -> None:
    sys.argv = [str(script), *options]
    sys.path.insert(0, str(script.parent))
    runpy.run_path(str(script), run_name="__main__")


def _missing(what: str) -> str:
    return f"*{what}: not drawn yet, as this study is not finished.*"
