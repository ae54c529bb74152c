"""Stored work is resumed by the call that it belongs to, and by no other."""

import inspect
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import identknee as ik
from identknee.runs.errors import InputError
from identknee.verbs import diagnosis
from identknee.verbs import subject as subject_facts
from identknee.verbs import verb as scaffold
from identknee.verbs.answer import Answer
from identknee.verbs.registry import verb_named, verbs

DRAWER = ik.load_protocol("drawer")
LAXITY = ik.Laxity(protocol=DRAWER, coordinates=np.zeros((DRAWER.n, 5)))
OTHER = replace(LAXITY, coordinates=LAXITY.coordinates + 1.0)


def function_of(verb: str) -> Callable[..., Answer]:
    """The function of the library that leaves results of this verb."""
    known = verb_named(verb)
    assert known is not None
    places = (import_module(known.module), diagnosis, subject_facts)
    for x in (y for place in places for name in dir(place) if callable(y := getattr(place, name))):
        inner = getattr(x, "__wrapped__", None)
        if inner and getattr(inner, scaffold.RECORDED, (inner.__name__,))[0] == verb:
            return cast("Callable[..., Answer]", x)
    raise AssertionError(f"no function leaves results of {verb}")


def arguments_of(verb: str) -> dict[str, Any]:
    """The arguments of a call with all options as they are by default."""
    given: dict[str, Any] = {"subject": ik.reference_knee(), "data": LAXITY}
    # What has no default.
    given |= {"protocol": "drawer", "noise": "0.3mm,0.3deg"}
    given |= {"results": ["one", "two"], "osim": "model.osim", "bundles": "separate", "out": None}
    given |= dict.fromkeys(("fitted", "source", "vtk", "written"), "none")
    return {
        name: given[name] if name == "subject" or x.default is x.empty else x.default
        for name, x in inspect.signature(function_of(verb)).parameters.items()
    }


def changed(name: str, value: Any) -> Any:
    """Another value of an option."""
    if name == "subject":
        first, *others = value.ligaments
        return value.with_ligaments([replace(first, stiffness_kN=9.0), *others])
    if name == "data":
        return OTHER
    if name == "uncertain":
        return "insertions=1mm"
    if name == "noise":
        return "0.4mm,0.4deg"
    if name == "discrepancy":
        return "smooth"
    if name == "plausible":
        return "default"
    if name in ("keep", "leave_out"):
        return [LAXITY.protocol.trials[0]]
    if name == "priors":
        return True
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    return f"{value} changed"


def cases() -> Iterator[tuple[str, str]]:
    for verb in (x.name for x in verbs()):
        for name in inspect.signature(function_of(verb)).parameters:
            yield verb, name


@pytest.mark.parametrize(("verb", "option"), list(cases()))
def test_another_value_of_an_option_is_another_work(verb: str, option: str, tmp_path: Path) -> None:
    """All options of all verbs, but those that cannot change a number."""
    function = function_of(verb).__wrapped__  # type: ignore[attr-defined]
    before = arguments_of(verb) | {"out": tmp_path}
    if option in ("keep", "leave_out"):
        before |= {"data": LAXITY}
    after = before | {option: changed(option, before[option])}
    if option == "out":
        after = before
    for arguments in (before, before):
        with scaffold._run(function, arguments) as (run, _, _):
            assert run.store is not None
    beside = {"out", "workers"} | getattr(function, scaffold.BESIDE, frozenset())
    with scaffold._run(function, after) as (run, _, _):
        if option in beside:
            assert run.store is not None
            return
        with pytest.raises(InputError, match=f"differs.*: .*{option}"):
            _ = run.store


def test_data_under_another_name_are_the_same_data(tmp_path: Path) -> None:
    first = ik.write_laxity(LAXITY, tmp_path / "first.csv")
    second = ik.write_laxity(LAXITY, tmp_path / "second.csv")
    function = ik.profile.__wrapped__  # type: ignore[attr-defined]
    for data in (first, second):
        with scaffold._run(function, arguments_of("profile") | {"data": data, "out": tmp_path}) as (
            run,
            _,
            _,
        ):
            assert run.store is not None
