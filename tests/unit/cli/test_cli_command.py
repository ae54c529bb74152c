"""How verbs end: sentences and exit codes instead of tracebacks."""

import errno
import logging
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import identknee as ik
from identknee.cli.app import Command, CommandGroup
from identknee.runs import crash_report as unforeseen
from identknee.runs.declare import frozen
from identknee.runs.errors import NotComputable
from identknee.runs.files import digest
from identknee.verbs.verb import knee_digest


def _ended(error: BaseException) -> tuple[int, str]:
    """Exit code and standard error of a verb that raises `error`."""
    app = typer.Typer(cls=CommandGroup, pretty_exceptions_enable=False)

    @app.command()
    def first() -> NoReturn:
        raise error

    @app.command()
    def second() -> None:
        pass

    result = CliRunner().invoke(app, ["first"])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stderr


def test_a_wrong_file_ends_with_its_sentence() -> None:
    error = ik.InputError("a.csv", "row 7", "it is wrong", "Mend it.")
    assert _ended(error) == (2, f"identknee: {error}\n")


def test_what_cannot_be_computed_ends_with_1() -> None:
    error = NotComputable("the knee snaps")
    assert _ended(error) == (1, f"identknee: {error}\n")


def test_a_missing_package_ends_with_1() -> None:
    error = ModuleNotFoundError("this method needs the package cma; install it")
    assert _ended(error) == (1, f"identknee: {error}\n")


def test_a_package_missing_without_a_word_of_ours_leads_to_the_doctor() -> None:
    error = ModuleNotFoundError("No module named 'numba'", name="numba")
    code, said = _ended(error)
    assert code == 1
    assert "'numba'" in said
    assert said.endswith(" identknee doctor\n")


def test_a_full_disk_ends_with_2() -> None:
    code, said = _ended(OSError(errno.ENOSPC, "No space left on device"))
    assert code == 2
    assert said.startswith("identknee: ")
    assert said.count("\n") == 1
    assert "left on device" in said


def test_too_little_memory_ends_with_1() -> None:
    code, said = _ended(MemoryError())
    assert code == 1
    assert "memory" in said


def test_ctrl_c_ends_with_130_and_a_sentence() -> None:
    code, said = _ended(KeyboardInterrupt())
    assert code == 130
    assert said.startswith("identknee: stopped; ")


def test_a_callers_mistake_ends_with_its_sentence() -> None:
    app = typer.Typer(cls=CommandGroup)

    @app.command()
    def first() -> None:
        frozen([1.0, 2.0], 3, name="the vector")

    @app.command()
    def second() -> None:
        pass

    result = CliRunner().invoke(app, ["first"])
    assert result.exit_code == 2
    assert re.match("identknee: the vector .*3", result.stderr)


def test_what_nobody_foresaw_ends_with_1_and_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unforeseen, "log_folder", lambda: tmp_path / "log")
    # A library's ValueError says nothing to a person.
    code, said = _ended(np.linalg.LinAlgError("3-th leading minor\nnot positive"))
    assert code == 1
    (path,) = (tmp_path / "log").iterdir()
    assert "(numpy.linalg.LinAlgError: 3-th leading minor not positive)" in said
    assert str(path) in said
    assert said.count("\n") == 1
    report = path.read_text(encoding="utf-8")
    for words in ("Traceback (most recent call last)", "not positive", "'numpy': ", "call: ["):
        assert words in report


def _verb(action: Callable[[Path], None]) -> typer.Typer:
    app = typer.Typer(cls=CommandGroup, pretty_exceptions_enable=False)

    @app.command(cls=Command)
    def first(data: Path, out: Path = Path("out")) -> None:
        out.mkdir(exist_ok=True)
        action(out)

    @app.command()
    def second() -> None:
        pass

    return app


def test_the_report_lies_in_the_folder_of_results_and_knows_the_inputs(tmp_path: Path) -> None:
    def fail(_: Path) -> None:
        raise RecursionError("too deep")

    data, out = tmp_path / "data.csv", tmp_path / "out"
    data.write_text("1")
    result = CliRunner().invoke(_verb(fail), ["first", str(data), "--out", str(out)])
    assert result.exit_code == 1
    (path,) = out.iterdir()
    assert str(path) in result.stderr
    assert f"data: {data}, SHA-256 {digest(data)}" in path.read_text(encoding="utf-8")


def test_a_refused_verb_leaves_no_folder_of_its_own(tmp_path: Path) -> None:
    def refuse(_: Path) -> None:
        raise ik.InputError("a.csv", "", "it is wrong", "Mend it.")

    def write_and_refuse(out: Path) -> None:
        (out / "kept").touch()
        refuse(out)

    old, new, kept = (tmp_path / x for x in ("old", "new", "kept"))
    old.mkdir()
    for action, out in ((refuse, old), (refuse, new), (write_and_refuse, kept)):
        result = CliRunner().invoke(_verb(action), ["first", "x", "--out", str(out)])
        assert result.exit_code == 2
    assert old.is_dir()
    assert not new.exists()
    assert (kept / "kept").exists()


def test_warnings_go_to_the_log_and_not_to_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def warn(_: Path) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            # As under a shell; the tests turn warnings into errors.
            warnings.showwarning = shown
            warnings.warn("divided by zero", RuntimeWarning, stacklevel=1)
        logging.getLogger("some.library").error("cannot read this")

    monkeypatch.setattr(unforeseen, "log_folder", lambda: tmp_path / "log")
    with unforeseen.warnings_to_log():
        shown = warnings.showwarning
    result = CliRunner().invoke(_verb(warn), ["first", "x", "--out", str(tmp_path / "out")])
    assert (result.exit_code, result.output) == (0, "")
    log = (tmp_path / "log" / unforeseen.LOG).read_text(encoding="utf-8")
    assert "RuntimeWarning: divided by zero" in log
    assert "some.library: cannot read this" in log
    assert not unforeseen.are_warnings_redirected()


def test_the_digest_of_a_knee_changes_with_any_number_of_it() -> None:
    knee = ik.reference_knee(edge_mm=4.0)
    first, *others = knee.ligaments
    moved = replace(first, femur=first.femur + np.array([0.0, 0.0, 1e-12]))
    assert knee_digest(knee) == knee_digest(ik.reference_knee(edge_mm=4.0))
    assert knee_digest(knee) != knee_digest(knee.with_ligaments([moved, *others]))
    assert knee_digest(knee) != knee_digest(ik.reference_knee(edge_mm=3.9))
