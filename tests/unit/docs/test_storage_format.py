"""The page on result files says what the files hold: no key too many, none too few."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from typer.testing import CliRunner

import identknee as ik
from identknee.cli.app import app

PAGE = Path(ik.__file__).parents[1] / "docs" / "storage_format.md"
SECTION = re.compile(r"^### (.+)$", re.MULTILINE)
ROW = re.compile(r"^\| `([^`]+)` \|(.*)\|$", re.MULTILINE)
ALWAYS = ""
SLOW_RUNS: Mapping[str, tuple[str, Sequence[str]]] = {
    "blind": ("blind", ["--effect", "compression", "--signal", "12"]),
}
Row = tuple[tuple[str, ...], str]


@cache
def sections(file: str) -> dict[str, str]:
    """Text of each section about a file by its title; verbs and groups share some names."""
    text = PAGE.read_text(encoding="utf-8").split(f"\n## {file}\n")[1].split("\n## ")[0]
    parts = SECTION.split(text)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


@cache
def keys_of(title: str) -> tuple[Row, ...]:
    """Paths of keys in a section, blocks filled in, each with the case it is there in."""
    found: list[Row] = []
    for text, rest in ROW.findall(sections("result.json")[title]):
        *path, last = text.split("/")
        only = rest.split("|")[-1].strip()
        if last.startswith("{"):
            found += [((*path, *inner), only or when) for inner, when in keys_of(last)]
        else:
            found.append(((*path, last), only))
    return tuple(found)


def paths(value: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], bool]]:
    """Paths of all leaves, and whether there is nothing: null, or an empty dictionary or list."""
    if isinstance(value, dict) and value:
        for key, below in value.items():
            yield from paths(below, (*above, key))
    elif isinstance(value, list) and any(isinstance(x, dict) for x in value):
        for below in value:
            yield from paths(below, (*above, "[]"))
    else:
        yield above, value in (None, [], {})


def is_one(name: str, pattern: str) -> bool:
    """Whether a key is what the page says, ``<...>`` being any name."""
    return re.fullmatch(re.sub(r"<[^>]+>", ".+", re.escape(pattern)), name) is not None


def fits(path: tuple[str, ...], pattern: tuple[str, ...], *, is_empty: bool) -> bool:
    """Whether a path is that of the page, or where it would have begun were there anything."""
    same = all(is_one(x, y) for x, y in zip(path, pattern, strict=False))
    return same and (len(path) == len(pattern) or (is_empty and len(path) < len(pattern)))


@cache
def reference() -> ik.Knee:
    """One knee for all runs, whose maps of the surfaces are then made once."""
    return ik.reference_knee()


def run(verb: str, words: Sequence[str], out: Path) -> Path:
    """Folder of the results of a verb on the reference knee."""
    read = ik.read_subject
    subject = [] if verb == "demo" else ["reference"]
    call = [*(x for x in verb.split() if not x.startswith("--")), *subject, *words]

    def read_once(subject: str) -> ik.Knee:
        return reference() if subject == "reference" else read(subject)

    with (
        patch.object(ik, "read_subject", read_once),
        patch("identknee.verbs.verb.read_subject", read_once),
    ):
        result = CliRunner().invoke(app, [*call, "--out", str(out)])
    assert result.exit_code == 0, result.output
    return out


def check_summary(out: Path, title: str) -> None:
    """Compare `result.json` with its tables."""
    summary = json.loads((out / "result.json").read_text(encoding="utf-8"))
    rows = keys_of(title) + keys_of("record")
    found = set(paths(summary))
    unknown = [
        path
        for path, is_empty in found
        if not any(fits(path, pattern, is_empty=is_empty) for pattern, _ in rows)
    ]
    assert unknown == []
    missing = [
        pattern
        for pattern, only in rows
        if only == ALWAYS and not any(fits(path, pattern, is_empty=True) for path, _ in found)
    ]
    assert missing == []


@pytest.mark.slow
@pytest.mark.parametrize("verb", SLOW_RUNS)
def test_the_page_is_that_of_the_files(verb: str, tmp_path: Path) -> None:
    title, words = SLOW_RUNS[verb]
    check_summary(run(verb, words, tmp_path), title)
