"""Print the lowest version of every package that pyproject.toml allows, as constraints for pip.

Run as ``python .ci/lowest_versions.py EXTRA... > constraints.txt``; what the package itself needs
is always among them.
"""

import sys
import tomllib
from pathlib import Path

from packaging.requirements import Requirement


def main() -> None:
    """Print them."""
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    project = tomllib.loads(text)["project"]
    lines = [*project["dependencies"]]
    for extra in sys.argv[1:]:
        lines += project["optional-dependencies"][extra]
    for line in lines:
        requirement = Requirement(line)
        lowest = [x.version for x in requirement.specifier if x.operator in (">=", "==")]
        if len(lowest) != 1:
            sys.exit(f"{line}: write one lower bound, for example {requirement.name}>=1.0")
        print(f"{requirement.name}=={lowest[0]}")


if __name__ == "__main__":
    main()
