"""What it takes to add something: reference patches, applied to a copy of the package and tried.

Each touches no more files of the package than its row allows. A patch that no longer applies is
made anew by hand: the same change on the code as it is now, as `git diff -U1`.
"""

import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

import identknee

HERE = Path(__file__).parent
PACKAGE = Path(identknee.__file__).parent
RESULTS = HERE.parent / "fuzz" / "results"
SUPPORT = HERE.parent / "support"


@dataclass(frozen=True, kw_only=True)
class Addition:
    """A patch, how many files of the package it may touch, and code that must run with it."""

    name: str
    most_files: int
    code: str


ADDITIONS = (
    Addition(
        name="verb",
        most_files=5,
        code="from typer.testing import CliRunner\n"
        "from identknee.cli.app import app\n"
        "made = CliRunner().invoke(app, ['longest', 'reference', '--out', 'made'])\n"
        "assert made.exit_code == 0, made.output\n"
        "assert 'The longest ligament is the MCL' in made.output, made.output\n"
        "assert ik.load('made').name == ik.longest('reference').name == 'MCL'\n"
        "assert 'Find the longest ligament' in CliRunner().invoke(app, ['--help']).output\n",
    ),
    Addition(
        name="diagnose_field",
        most_files=2,
        code="from identknee.runs.schema import summary_of\n"
        f"assert summary_of(ik.load({str(RESULTS / 'diagnose')!r}))['n_causes'] == 1\n",
    ),
    Addition(
        name="profile_field",
        most_files=1,
        code="from identknee.runs.schema import summary_of\n"
        f"assert summary_of(ik.load({str(RESULTS / 'profile')!r}))['n_bounded'] in (0, 1)\n",
    ),
    Addition(
        name="effect",
        most_files=3,
        code="import numpy as np\n"
        "effect = ik.effect_named(ik.reference_knee(), 'force_gain')\n"
        "loads = np.eye(5)\n"
        "acted = effect.acted(loads, np.zeros(5), np.array([0.5]))\n"
        "assert acted[2].tolist() == [0, 0, 1.5, 0, 0]\n"
        "assert effect.parameters.names == ('force_gain.gain',)\n",
    ),
    Addition(
        name="finding",
        most_files=2,
        code="from identknee.checks.table_checks import angle_findings\n"
        "data = ik.example_laxity('s192803').select([0])\n"
        "(found,) = angle_findings(data)\n"
        "assert (found.code, found.values['n_trials']) == ('one-flexion-angle', 1)\n",
    ),
    Addition(
        name="nuisance",
        most_files=3,
        code="from identknee.model.nuisances import nuisances_of\n"
        "from identknee.subject.knee import Uncertainty, with_stated_uncertainty\n"
        "stated = with_stated_uncertainty(Uncertainty(), 'length_scale=2%')\n"
        "(made,) = nuisances_of(ik.reference_knee().with_uncertainty(stated))\n"
        "assert made.parameters.nuisance_names == ('length_scale.ln_scale',)\n"
        "assert made.parameters.prior_sd.tolist() == [0.02]\n",
    ),
    Addition(
        name="optimizer",
        most_files=3,
        code=f"sys.path.insert(0, {str(SUPPORT)!r})\n"
        "from problems import linear\n"
        "from identknee.calibrate.fit import fit\n"
        "problem = linear()\n"
        "few, many = (fit(problem, problem.start, method='random', budget=n) for n in (20, 400))\n"
        "assert many.objective < few.objective\n"
        "assert many.n_simulations == 400\n",
    ),
)


@pytest.mark.parametrize("addition", ADDITIONS, ids=lambda x: x.name)
def test_an_addition_touches_few_files_and_works(addition: Addition, tmp_path: Path) -> None:
    patch = HERE / f"{addition.name}.patch"
    touched = set(re.findall(r"^\+\+\+ b/(identknee/\S+)", patch.read_text("utf-8"), re.MULTILINE))
    assert 0 < len(touched) <= addition.most_files
    # With what is compiled: it goes by the times of the sources, which a patch changes.
    shutil.copytree(PACKAGE, tmp_path / "identknee", ignore=shutil.ignore_patterns("knees"))
    # Read only, and large.
    (tmp_path / "identknee" / "subject" / "knees").symlink_to(PACKAGE / "subject" / "knees")
    subprocess.run(["git", "apply", str(patch)], cwd=tmp_path, check=True)
    code = f"import sys\nsys.path.insert(0, {str(tmp_path)!r})\nimport identknee as ik\n"
    code += f"assert ik.__file__.startswith({str(tmp_path)!r})\n{addition.code}"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
