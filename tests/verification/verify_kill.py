"""Verbs killed at random moments: the same command again must end with the same bits."""

import argparse
import hashlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from killed_commands import run_for
from requirement_rows import Measure, Row
from work_store import work_store

from identknee.runs.store import json_round_trip, resumable_map

KILLS, SEED = 50, 0
# Each is to take about half a minute on two slow cores, most of it in work that is resumed.
VERBS = {
    "sweep": ["--n-starts", "200", "--paths", "10"],
    "profile": [],
    "sample": ["--budget", "3000"],
}
COMMAND = [sys.executable, "-m", "identknee.cli.main"]
# What differs from run to run: when, how long, on what.
TIMES = ("seconds", "timing", "record", "started")


def measure(options: argparse.Namespace) -> Row:
    """How many of the resumed runs differ from an undisturbed one in any number."""
    with (
        work_store("kill", {"verbs": VERBS, "kills": KILLS, "seed": SEED}) as store,
        tempfile.TemporaryDirectory() as folder,
    ):
        data = _data(Path(folder))
        whole = resumable_map(partial(undisturbed, data), list(VERBS), store=store, name="whole")
        expected = dict(zip(VERBS, whole, strict=True))
        tasks = [(list(VERBS)[i % len(VERBS)], i) for i in range(KILLS)]
        found = resumable_map(partial(killed, data, expected), tasks, store=store, name="kills")
    different = [f"{x['verb']} killed after {x['after']:.2f} s" for x in found if x["differing"]]
    return Row(
        line="kill -9 at 50 random moments across sweep, profile, sample: each resumes to the "
        "bit-equal result",
        measures=[
            Measure(what="kills", value=len(found), unit="", bar=KILLS, at_least=True),
            Measure(what="results that differ", value=len(different), unit="", bar=0),
        ],
        notes=[*(_note(verb, expected[verb], found) for verb in VERBS), *different],
    )


def undisturbed(data: Path, verb: str) -> dict[str, Any]:
    """What a run to the end takes [s] and gives, as digests by place."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        code = run_for(_command(verb, data, Path(folder)), None)
        seconds = time.perf_counter() - began
        return {"seconds": seconds, "digests": _digests(Path(folder), verb, code)}


def killed(data: Path, expected: dict[str, Any], task: tuple[str, int]) -> dict[str, Any]:
    """What a run gives that was killed once and then run again to the end."""
    verb, number = task
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(number,)))
    while True:
        after = rng.uniform(0.0, expected[verb]["seconds"])
        with tempfile.TemporaryDirectory() as folder:
            command = _command(verb, data, Path(folder))
            # What a killed run leaves among temporary files goes with the folder.
            if run_for(command, after, {**os.environ, "TMPDIR": folder}) is not None:
                continue  # It ended before; another moment.
            has_result = (Path(folder) / "result.json").exists()
            began = time.perf_counter()
            code = run_for(command, None)
            seconds = time.perf_counter() - began
            digests = _digests(Path(folder), verb, code)
        return {
            "verb": verb,
            "after": after,
            "had_result": has_result,
            "seconds_again": seconds,
            "differing": _differing(digests, expected[verb]["digests"]),
        }


def _data(folder: Path) -> Path:
    words = ["simulate", "reference", "--noise", "0.5mm,0.5deg", "--out", str(folder)]
    if run_for([*COMMAND, *words], None) != 0:
        raise RuntimeError("identknee simulate did not end well")
    return folder / "laxity.csv"


def _command(verb: str, data: Path, out: Path) -> list[str]:
    words = [verb, "reference", str(data), *VERBS[verb], "--workers", "2", "--out", str(out)]
    return [*COMMAND, *words]


def _digests(folder: Path, verb: str, code: int | None) -> dict[str, str]:
    """Digest of every number of a result, by where it stands, times left out."""
    if not (folder / "result.json").exists():
        raise RuntimeError(f"identknee {verb} left no result; its exit code is {code}")
    summary = json.loads((folder / "result.json").read_text("utf-8"))
    texts = {f"json {place}": json.dumps(value) for place, value in _leaves(summary)}
    with xarray.open_datatree(folder / "result.nc", engine="netcdf4") as tree:
        for place, value in _arrays(tree):
            texts[f"nc {place}"] = value
    return {
        place: hashlib.sha256(text.encode()).hexdigest()[:16]
        for place, text in texts.items()
        if not any(part.startswith(TIMES) for part in place.replace("/", " ").split())
    }


def _arrays(tree: xarray.DataTree) -> Iterator[tuple[str, str]]:
    for node in tree.subtree:
        for name, array in node.to_dataset(inherit=False).variables.items():
            # As the shortest text that reads back equal: NaN equals itself there.
            text = json.dumps(json_round_trip(array.values))
            yield f"{node.path}/{name}", f"{array.dtype} {array.dims} {text}"


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, f"{place}/{key}")
    else:
        yield place, value


def _differing(found: dict[str, str], expected: dict[str, str]) -> list[str]:
    places = {*found, *expected}
    return sorted(x for x in places if found.get(x) != expected.get(x))


def _note(verb: str, whole: dict[str, Any], found: list[dict[str, Any]]) -> str:
    own = [x for x in found if x["verb"] == verb]
    moments = [x["after"] for x in own]
    again = float(np.mean([x["seconds_again"] for x in own]))
    return (
        f"{verb}: {len(own)} kills after {min(moments):.1f} to {max(moments):.1f} s of "
        f"{whole['seconds']:.1f} s, {again:.1f} s on average to the end from there, "
        f"{len(whole['digests'])} values compared"
    )
