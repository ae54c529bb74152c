"""Exit codes by what an answer finds, over all verbs: 1 after an error, 0 after anything less."""

import functools
import json
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cli_runs import run, summary_in
from typing_extensions import override

from identknee.cli import app
from identknee.runs.declare import declared
from identknee.runs.findings import KINDS, Finding, Severity
from identknee.verbs.answer import Answer
from identknee.verbs.registry import Verb, verbs

COMMANDS = [x for x in verbs() if x.summary]


@declared
class Stub(Answer):
    """An answer with findings and nothing else."""

    @override
    def __str__(self) -> str:
        """A line for each finding."""
        return "\n".join(["the answer", *(x.line for x in self.findings)])

    brief = __str__


def of(severity: Severity, code: str = "fit-unfinished") -> Finding:
    return Finding(code=code, severity=severity, sentence="it is so.", where="data")


ERROR, WARNING, INFO = (of(x) for x in (Severity.ERROR, Severity.WARNING, Severity.INFO))
FATAL = of(Severity.ERROR, "nothing-fitted")


def ended(
    verb: Verb, found: tuple[Finding, ...], monkeypatch: pytest.MonkeyPatch, *more: object
) -> Any:
    """The command of a verb that finds this, without its pictures and page."""
    call: Callable[..., Any] = verb.call

    @functools.wraps(call)
    def found_so(**_: Any) -> Stub:
        return Stub(findings=found)

    known = [replace(x, has_pictures=False, has_page=False) for x in verbs()]
    monkeypatch.setattr(app, "verbs", lambda: known)
    monkeypatch.setattr(Verb, "call", property(lambda _: found_so))
    return run(*verb.name.split(), *shlex.split(verb.example), *more)


@pytest.mark.parametrize("verb", COMMANDS, ids=lambda x: x.name)
@pytest.mark.parametrize(
    ("found", "code"),
    [
        ((), 0),
        ((INFO,), 0),
        ((WARNING, INFO), 0),
        ((ERROR,), 1),
        ((INFO, WARNING, ERROR), 1),
        ((FATAL, ERROR), 1),
    ],
)
def test_a_verb_ends_with_1_after_an_error_and_else_with_0(
    verb: Verb, found: tuple[Finding, ...], code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = ended(verb, found, monkeypatch)
    assert result.exit_code == code, result.output
    # The answer is printed whatever it found, and the last line of an error says why 1.
    assert "the answer" in result.stdout
    assert ("fit-unfinished" in result.stderr) is (found != (FATAL, ERROR) and code == 1)
    if code:
        assert result.stderr.strip().splitlines()[-1].startswith("identknee: ")


@pytest.mark.parametrize("verb", COMMANDS, ids=lambda x: x.name)
def test_the_same_codes_end_a_verb_that_prints_json(
    verb: Verb, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = ended(verb, (ERROR,), monkeypatch, "--json")
    assert result.exit_code == 1
    assert [x["severity"] for x in json.loads(result.stdout)["findings"]] == ["error"]


def test_every_kind_that_invalidates_is_an_error() -> None:
    assert {x.severity for x in KINDS.values() if x.invalidates} == {Severity.ERROR}


def test_a_misfit_that_is_no_noise_ends_with_1_and_its_results(tmp_path: Path) -> None:
    made = run("simulate", "reference", "--protocol", "drawer", "--out", tmp_path / "data")
    assert made.exit_code == 0, made.output
    # Held four times softer than the truth.
    fixed = ["--fix", "ACL.stiffness_kN", "--fix", "PCL.stiffness_kN"]
    start = tmp_path / "start.toml"
    start.write_text("ACL.stiffness_kN = 2.5\nPCL.stiffness_kN = 4.5\n", encoding="utf-8")
    words = ["--noise", "0.01mm,0.01deg", "--start", start, *fixed]
    result = run("fit", "reference", tmp_path / "data" / "laxity.csv", *words, "--out", tmp_path)
    assert result.exit_code == 1, result.output
    found = summary_in(tmp_path)["findings"]
    assert "misfit-gross" in [x["code"] for x in found]
    assert "misfit-gross" in result.stderr
