"""The command as a whole."""

import os
import re
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from cli_runs import run

VERBS = (
    ("demo",),
    ("simulate",),
    ("fit",),
    ("sweep",),
    ("profile",),
    ("sample",),
    ("information",),
    ("sensitivity",),
    ("equivalents",),
    ("design",),
    ("diagnose",),
    ("blind",),
    ("subject", "check"),
    ("subject", "show"),
    ("subject", "export"),
    ("subject", "import-osim"),
)


def test_the_version_is_that_of_the_package() -> None:
    assert run("--version").stdout == f"identknee {version('identknee')}\n"


def test_the_package_runs_as_a_module() -> None:
    words = [sys.executable, "-m", "identknee", "--version"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout == f"identknee {version('identknee')}\n"


@pytest.mark.parametrize("group", [(), ("subject",)])
def test_a_list_of_commands_cuts_no_sentence_off(group: tuple[str, ...]) -> None:
    listed = run(*group, "--help").stdout.partition("Commands:")[2]
    assert len(listed.splitlines()) > 5
    assert "..." not in listed


def test_without_a_verb_the_help_is_shown() -> None:
    result = run()
    assert result.exit_code == 2
    for verb in VERBS:
        assert verb[0] in result.output


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_the_same_four_options(verb: tuple[str, ...]) -> None:
    result = run(*verb, "--help")
    assert result.exit_code == 0
    for option in ("--out DIR", "--seed", "--workers", "--json"):
        assert option in result.stdout
    assert f"Example: identknee {' '.join(verb)} " in result.stdout


def test_an_unknown_verb_is_refused() -> None:
    result = run("fti")
    assert result.exit_code == 2
    assert "'fti'" in result.stderr


def test_the_module_is_the_command() -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "identknee.cli.main", "--help"],
        check=True,
        capture_output=True,
        text=True,
    )
    assert "subject list" in answer.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
@pytest.mark.parametrize("where", ["import decimal_that_is_slow", "time.sleep(60)"])
def test_ctrl_c_ends_with_130_wherever_it_comes(where: str, tmp_path: Path) -> None:
    # A module that swallows everything raised while it is imported, as some libraries do.
    (tmp_path / "decimal_that_is_slow.py").write_text(
        "import time\ntry:\n    print('now', flush=True)\n    time.sleep(60)\n"
        "except BaseException:\n    pass\n",
        encoding="utf-8",
    )
    code = (
        "import sys, time, types; from identknee.cli import main\n"
        f"def app(prog_name):\n    print('now', flush=True)\n    {where}\n"
        "sys.modules['identknee.cli.app'] = types.SimpleNamespace(app=app); main.main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "now\n"
    if "import" in where:
        assert process.stdout.readline() == "now\n"
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert re.fullmatch("identknee: stopped.*\n", said)


def test_a_missing_package_leaves_a_sentence() -> None:
    code = "import sys; from identknee.cli import main\nsys.modules['typer'] = None; main.main()"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 1
    assert "typer" in process.stderr
    assert process.stderr.endswith(": pip install .\n")


def test_the_help_of_all_verbs_loads_no_schemas_and_no_arrays_of_results() -> None:
    code = (
        "import sys, identknee.cli.app; print({'pydantic', 'xarray', 'scipy'} & set(sys.modules))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert answer.stdout == "set()\n"


def test_a_printed_answer_loads_nothing_that_draws_or_fits_and_no_other_verb(
    tmp_path: Path,
) -> None:
    unneeded = {"matplotlib", "scipy.optimize", "scipy.stats", "trimesh"}
    unneeded |= {"identknee.verbs.fit", "identknee.verbs.sample"}
    code = (
        "import sys; from identknee.cli.main import main\n"
        f"sys.argv = ['identknee', 'simulate', 'reference', '--out', {str(tmp_path)!r}]\n"
        f"try: main()\nfinally: print({unneeded!r} & set(sys.modules))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert answer.stdout.splitlines()[-1] == "set()"
