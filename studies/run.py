"""One study done again from a clone: its record computed, its figures drawn, its page filled.

    python studies/run.py 01             # or 01_model_evaluation; options of its compute.py follow
    python studies/run.py 03 --quick     # a small version, which leaves record and page alone

All knees and tables that a study needs come with identknee.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

STUDIES = Path(__file__).parent


def main(words: Sequence[str] | None = None) -> None:
    """Do the study that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("study", help="its folder, or how the folder's name begins, such as 01")
    chosen, options = parser.parse_known_args(words)
    study = study_called(chosen.study)
    if "--quick" in options and not any(x.startswith("--record") for x in options):
        place = Path(tempfile.mkdtemp(prefix="identknee-study-")) / f"{study.name}.json"
        options += ["--record", str(place)]
        print(f"The record of the small version: {place}", flush=True)
    done(study / "compute.py", *options)
    if any(x.startswith("--record") for x in options):
        print("The page was left as it is: it shows the committed record.")
        return
    done(study / "figures.py")


def study_called(name: str) -> Path:
    """Folder of the one study whose name begins so."""
    names = sorted(x.parent.name for x in STUDIES.glob("*/compute.py"))
    found = [x for x in names if x.startswith(Path(name).name)]
    if len(found) != 1:
        raise SystemExit(f"{name!r} is not one study; studies are {', '.join(names)}")
    return STUDIES / found[0]


def done(script: Path, *options: str) -> None:
    """Run a script of the study; what it ends with is how this ends."""
    ended = subprocess.run([sys.executable, str(script), *options], check=False)
    if ended.returncode != 0:
        raise SystemExit(ended.returncode)


if __name__ == "__main__":
    main()
