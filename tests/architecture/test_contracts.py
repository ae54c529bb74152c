"""The layers: who may import whom."""

import subprocess
import sys
from pathlib import Path

import pytest

import identknee

ROOT = Path(identknee.__file__).parents[1]


def test_import_contracts_are_kept(tmp_path: Path) -> None:
    pytest.importorskip("importlinter", reason="import-linter is not installed")
    if not (ROOT / "pyproject.toml").exists():
        pytest.skip("the contracts stand in pyproject.toml, which an installed package lacks")
    code = "from importlinter.cli import lint_imports_command as run; run()"
    answer = subprocess.run(
        [sys.executable, "-c", code, "--cache-dir", str(tmp_path)],
        check=False,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert answer.returncode == 0, answer.stdout
