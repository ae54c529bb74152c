import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from identknee.runs.errors import InputError
from identknee.runs.files import (
    BACKSLASH,
    check_readable,
    digest,
    plain,
    prepare_folder,
    temporary_path_beside,
    write_atomically,
    write_json,
)
from identknee.runs.record import Outcome


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_write_replaces_the_file_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    write_atomically(path, "old")
    write_atomically(path, "new ä\r\n")
    assert path.read_bytes() == "new ä\r\n".encode()
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize(
    ("code", "words"),
    [(errno.ENOSPC, "the disk is full"), (errno.EACCES, "may not be written")],
)
def test_a_failed_write_keeps_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, words: str
) -> None:
    path = tmp_path / "a.txt"
    write_atomically(path, "old")

    def fail(_descriptor: int) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match=words):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_an_interrupted_write_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(_descriptor: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a.txt", "new")
    assert names(tmp_path) == []


def test_write_into_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"not exist"):
        write_atomically(tmp_path / "no" / "a.txt", "x")


def test_prepare_folder(tmp_path: Path) -> None:
    folder = prepare_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert names(folder) == []
    (tmp_path / "file").write_text("x")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match=r"file.*: a file"):
            prepare_folder(path)


def test_prepare_folder_that_may_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_self: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "touch", refuse)
    with pytest.raises(InputError, match=r"permission denied.*--out"):
        prepare_folder(tmp_path)


def test_check_readable(tmp_path: Path) -> None:
    full, empty = tmp_path / "full", tmp_path / "empty"
    full.write_text("x")
    empty.touch()
    assert check_readable(full) == full
    for path, words in (
        (tmp_path / "none", r"there is no such file\. Check the spelling"),
        (tmp_path, "this is a folder"),
        (empty, "the file is empty"),
    ):
        with pytest.raises(InputError, match=words):
            check_readable(path)


@pytest.mark.parametrize("path", ["C:\temp\femur.ply", "knee/C:\new\rest.ply", "meshes\femur.ply"])
def test_a_path_whose_backslashes_became_special_characters_is_named(path: str) -> None:
    with pytest.raises(InputError) as caught:
        check_readable(path)
    assert caught.value.path == repr(path)
    assert caught.value.remedy == BACKSLASH
    for text in ("a\tb\n1\t2\n" * 5000, "a,b\n1,2\n"):
        with pytest.raises(InputError, match="lines, not the path of a file"):
            check_readable(text)


def test_check_readable_refuses_large_files(tmp_path: Path) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(513 * 10**6)
    with pytest.raises(InputError, match=r"513 MB.*512 MB"):
        check_readable(path)


def test_digest_of_path_and_bytes_agree(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert digest(path) == digest(str(path)) == digest(b"abc") == known


def test_write_json(tmp_path: Path) -> None:
    values = {
        "outcome": Outcome.FOLD,
        "theta": np.array([0.1, np.nan, np.inf]),
        "n": np.int64(3),
        "third": 1 / 3,
        "path": Path("a.csv"),
        "none": None,
        "flag": np.bool_(True),
    }
    read = json.loads(write_json(tmp_path / "a.json", values).read_text())
    assert read == {
        "outcome": "fold",
        "theta": [0.1, None, None],
        "n": 3,
        "third": 1 / 3,
        "path": "a.csv",
        "none": None,
        "flag": True,
    }


def test_plain_refuses_what_json_cannot_hold() -> None:
    with pytest.raises(TypeError, match=r"object.*JSON"):
        plain({"a": object()})


def test_parts_of_a_killed_process_go_and_those_of_a_living_one_stay(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    dead = tmp_path / f".result.nc.{process.pid}-0123abcd.part"
    folder = tmp_path / f".subject.{process.pid}-0123abc_.part"
    living = temporary_path_beside(tmp_path / "result.nc")
    other = tmp_path / ".something.part"
    folder.mkdir()
    for path in (dead, folder / "a.ply", living, other):
        path.touch()
    prepare_folder(tmp_path)
    assert set(tmp_path.iterdir()) == {living, other}
