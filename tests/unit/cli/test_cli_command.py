"""How verbs end: sentences and exit codes instead of tracebacks."""

import errno
from dataclasses import replace
from typing import NoReturn

import numpy as np
import typer
from typer.testing import CliRunner

import identknee as ik
from identknee.cli.command import NotComputed, Verbs, knee_digest, nested
from identknee.runs.arrays import frozen


def _ended(error: BaseException) -> tuple[int, str]:
    """Exit code and standard error of a verb that raises `error`."""
    app = typer.Typer(cls=Verbs, pretty_exceptions_enable=False)

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
    code, said = _ended(ik.InputError("a.csv", "row 7", "it is wrong", "Mend it."))
    assert (code, said) == (2, "identknee: a.csv, row 7: it is wrong. Mend it.\n")


def test_what_cannot_be_computed_ends_with_1() -> None:
    assert _ended(NotComputed("the knee snaps")) == (1, "identknee: the knee snaps\n")


def test_a_missing_package_ends_with_1() -> None:
    error = ModuleNotFoundError("this method needs the package cma; install it")
    assert _ended(error) == (1, f"identknee: {error}\n")


def test_a_package_missing_without_a_word_of_ours_leads_to_the_doctor() -> None:
    error = ModuleNotFoundError("No module named 'numba'", name="numba")
    code, said = _ended(error)
    assert code == 1
    assert said.endswith("No module named 'numba'. To see what is missing: identknee doctor\n")


def test_a_full_disk_ends_with_2() -> None:
    code, said = _ended(OSError(errno.ENOSPC, "No space left on device"))
    assert code == 2
    assert said.startswith("identknee: a file or folder cannot be used: ")
    assert "No space left on device" in said


def test_too_little_memory_ends_with_1() -> None:
    assert _ended(MemoryError()) == (1, "identknee: there is not enough memory\n")


def test_ctrl_c_ends_with_130_and_a_sentence() -> None:
    code, said = _ended(KeyboardInterrupt())
    assert code == 130
    assert said == "identknee: stopped; the same command does it again from the start\n"


def test_a_callers_mistake_ends_with_its_sentence() -> None:
    app = typer.Typer(cls=Verbs)

    @app.command()
    def first() -> None:
        frozen([1.0, 2.0], 3, name="the vector")

    @app.command()
    def second() -> None:
        pass

    result = CliRunner().invoke(app, ["first"])
    assert result.exit_code == 2
    assert result.stderr.startswith("identknee: the vector must have shape 3")


def test_a_librarys_value_error_is_a_bug_and_stays_one() -> None:
    app = typer.Typer(cls=Verbs, pretty_exceptions_enable=False)

    @app.command()
    def first() -> None:
        np.linalg.cholesky(-np.eye(2))

    @app.command()
    def second() -> None:
        pass

    assert isinstance(CliRunner().invoke(app, ["first"]).exception, np.linalg.LinAlgError)


def test_nested_splits_at_the_last_dot() -> None:
    assert nested({"a.b.k": 1.0, "a.b.e": 2.0, "c.k": 3.0}) == {
        "a.b": {"k": 1.0, "e": 2.0},
        "c": {"k": 3.0},
    }


def test_the_digest_of_a_knee_changes_with_any_number_of_it() -> None:
    knee = ik.reference_knee(edge_mm=4.0)
    first, *others = knee.ligaments
    moved = replace(first, femur=first.femur + np.array([0.0, 0.0, 1e-12]))
    assert knee_digest(knee) == knee_digest(ik.reference_knee(edge_mm=4.0))
    assert knee_digest(knee) != knee_digest(knee.with_ligaments([moved, *others]))
    assert knee_digest(knee) != knee_digest(ik.reference_knee(edge_mm=3.9))
