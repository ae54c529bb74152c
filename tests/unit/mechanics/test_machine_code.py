"""Compiled functions as Python calls them."""

import json
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest

from identknee.mechanics import machine_code
from identknee.mechanics.compiled import compiled_in_place
from identknee.mechanics.machine_code import MachineCode, Packed
from identknee.model.laxity_model import LaxityModel


class Group(NamedTuple):
    """Arrays of several types and numbers of axes, and more below."""

    cube: Any
    flags: Any
    inner: tuple[Any, ...]


@compiled_in_place
def fill(values, group, factor, is_doubled, result):  # type: ignore[no-untyped-def]
    """Write what depends on every element of every argument."""
    n = 0
    for i in range(group.cube.shape[0]):
        for j in range(group.cube.shape[1]):
            for k in range(group.cube.shape[2]):
                if group.flags[j]:
                    result[i, k] += group.cube[i, j, k] * factor * (2.0 if is_doubled else 1.0)
    counts, codes = group.inner
    for i in range(values.shape[0]):
        n += counts[i] + codes[i]
        result[0, 0] += values[i]
    counts[0] = n


# The process that compiles imports this module by its name.
FILL = MachineCode("test_machine_code", "fill")


@pytest.fixture(autouse=True)
def _importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


def _arguments(seed: int) -> tuple[Any, ...]:
    rng = np.random.default_rng(seed)
    inner = rng.integers(0, 9, 3), rng.integers(0, 9, 3).astype(np.uint16)
    group = Group(cube=rng.normal(size=(2, 4, 3)), flags=rng.random(4) < 0.5, inner=inner)
    return rng.normal(size=3), group, 3, bool(seed % 2), np.zeros((2, 3))


def _expected(arguments: tuple[Any, ...]) -> tuple[np.ndarray, int]:
    values, group, factor, is_doubled, _ = arguments
    result = factor * (1 + is_doubled) * group.cube[:, group.flags].sum(axis=1)
    result[0, 0] += values.sum()
    return result, int(group.inner[0].sum() + group.inner[1].sum())


@pytest.mark.parametrize("seed", range(4))
def test_every_kind_of_argument_arrives(seed: int) -> None:
    arguments = _arguments(seed)
    result, count = _expected(arguments)
    FILL(*arguments)
    assert arguments[-1] == pytest.approx(result, rel=1e-12)
    assert arguments[1].inner[0][0] == count


def test_packed_arguments_are_the_same() -> None:
    values, group, *others, result = _arguments(1)
    expected, _ = _expected((values, group, *others, result))
    FILL(values, Packed(group), *others, Packed(result))
    assert result == pytest.approx(expected, rel=1e-12)


def test_packed_arguments_do_not_travel() -> None:
    with pytest.raises(TypeError, match="another process"):
        pickle.dumps(Packed(np.zeros(2)))


def test_only_arrays_in_c_order_are_taken() -> None:
    with pytest.raises(ValueError, match="C order"):
        Packed(np.zeros((3, 2)).T)


def test_threads_may_come_first_together() -> None:
    with mock.patch.object(machine_code, "_load", side_effect=machine_code._load) as load:
        function = MachineCode("test_machine_code", "fill")
        cases = [_arguments(seed) for seed in (1, 3, 5, 7)]
        expected = [_expected(x)[0] for x in cases]
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda x: function(*x), cases))
        for case, result in zip(cases, expected, strict=True):
            assert case[-1] == pytest.approx(result, rel=1e-12)
    assert load.call_count == 1


RUN = """
import json, sys
import numpy as np
from identknee.mechanics.compiled_folder import compiled_folder
from identknee.mechanics.machine_code import MachineCode
total = np.zeros(1)
MachineCode("toy", "add")(np.arange(5.0), total)
kept = len(list(compiled_folder().glob("add-*.o"))) if compiled_folder().is_dir() else 0
print(json.dumps([total[0], kept, "numba" in sys.modules]))
"""
TOY = """
from identknee.mechanics import machine_code
from identknee.mechanics.compiled import compiled_in_place

@compiled_in_place
def add(values, total):
    for x in values:
        total[0] += x * x
"""


def _run_toy(folder: Path, cache: Path, before: str = "") -> list[float]:
    (folder / "toy.py").write_text(TOY)
    path = os.pathsep.join([str(folder), str(Path(__file__).parents[3])])
    answer = subprocess.run(
        [sys.executable, "-c", before + RUN],
        env={**os.environ, "PYTHONPATH": path, "IDENTKNEE_CACHE": str(cache)},
        check=True,
        capture_output=True,
    )
    found: list[float] = json.loads(answer.stdout)
    return found


def test_no_process_that_calls_loads_the_compiler(tmp_path: Path) -> None:
    for _ in range(2):
        assert _run_toy(tmp_path, tmp_path / "cache") == [30.0, 1, False]


def test_without_a_cache_every_process_has_it_compiled(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert _run_toy(tmp_path, tmp_path / "file" / "cache") == [30.0, 0, False]


def test_where_no_process_can_be_started_this_one_compiles(tmp_path: Path) -> None:
    before = "import sys; sys.executable = '/nowhere/python'\n"
    assert _run_toy(tmp_path, tmp_path / "cache", before) == [30.0, 1, True]


SIMULATE = """
import sys
import identknee as ik
found = ik.simulate(ik.reference_knee(), ik.load_protocol("drawer"))
print(found.n_converged, "numba" in sys.modules)
"""


def test_a_simulation_loads_no_compiler(reference_model: LaxityModel) -> None:
    reference_model.predict(reference_model.parameters.center)  # Compiled, if it was not before.
    answer = subprocess.run([sys.executable, "-c", SIMULATE], check=True, capture_output=True)
    assert answer.stdout.split() == [b"9", b"False"]
