"""Findings: every code is registered once, and nothing but codes and values is compared."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from package_trees import MODULES, nodes_of

from identknee.runs.findings import (
    KINDS,
    Finding,
    Severity,
    by_severity,
    finding,
    invalidating,
    without_repeats,
)
from identknee.runs.schema import from_plain, summary_of

MAKERS = {"finding", "geometry_finding", "trial_findings"}
CLASSES = {"Finding", "GeometryFinding"}
# A sentence is made for a person, and never read by the package.
TAKEN_APART = re.compile(
    r"sentence\.(r?partition|r?split|startswith|endswith|remove\w+|r?strip|r?find|r?index)\("
    r"|\bin \w+\.sentence\b|\bre\.\w+\([^)]*sentence"
)


@cache
def calls() -> tuple[tuple[Path, ast.Call, str], ...]:
    """Where findings are made, and by what."""
    return tuple(
        (path, node, node.func.id)
        for path in MODULES
        for node in nodes_of(path)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        if node.func.id in (*MAKERS, *CLASSES)
    )


def words() -> set[str]:
    """All texts of the package but those of the registry."""
    return {
        node.value
        for path in MODULES
        if path.name != "findings.py"
        for node in nodes_of(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


def test_every_kind_is_registered_once_and_made_somewhere() -> None:
    used = words()
    assert [code for code in KINDS if code not in used] == []
    given = {
        x.value
        for _, node, name in calls()
        if name in MAKERS
        for x in node.args
        if isinstance(x, ast.Constant) and re.fullmatch(r"[a-z]+(-[a-z]+)+", str(x.value))
    }
    assert given <= KINDS.keys()
    assert len(given) > 40


def test_checks_make_findings_with_their_code_only() -> None:
    made = {path.name for path, _, name in calls() if name in CLASSES}
    assert made <= {"findings.py", "check.py"}


def test_no_code_takes_a_sentence_apart() -> None:
    found = [
        f"{path.name}: {match[0]}"
        for path in MODULES
        for match in TAKEN_APART.finditer(path.read_text(encoding="utf-8"))
    ]
    assert found == []


@pytest.mark.parametrize("code", KINDS)
def test_every_kind_says_what_it_means_and_what_to_do(code: str) -> None:
    kind = KINDS[code]
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", code)
    assert kind.meaning.endswith(".")
    assert kind.remedy or kind.severity is Severity.INFO
    assert not kind.invalidates or kind.severity is Severity.ERROR
    assert not kind.lead or not kind.template.endswith(".")


def test_an_unregistered_code_is_refused() -> None:
    with pytest.raises(ValueError, match="finding 'misfit'"):
        finding("misfit", "data", sentence="So.")
    with pytest.raises(ValueError, match="finding 'misfit'"):
        Finding(code="misfit", severity=Severity.INFO, sentence="So.", where="data")


def test_values_that_do_not_fill_the_sentence_are_refused() -> None:
    made = finding("sets-without-prediction", "model", {"n": 100, "n_lost": 7})
    assert re.search(r"\b100\b.*\b7\b", made.sentence)
    stored = summary_of(made)
    again = from_plain(Finding, stored)
    assert summary_of(again) == stored
    with pytest.raises(ValueError, match=r"values.*'sets-without-prediction'"):
        from_plain(Finding, stored | {"values": {"n": 100}})


def test_what_an_earlier_version_stored_has_no_code() -> None:
    old = {"severity": "warning", "sentence": "Look.", "where": "data"}
    made = from_plain(Finding, old)
    assert (made.code, dict(made.values), made.line) == ("", {}, "Warning: Look.")
    assert invalidating([made]) == ""


def test_severity_then_the_order_of_kinds_decides_and_repeats_go() -> None:
    rim = finding("contact-near-rim", "subject", sentence="Near.")
    bound = finding("at-bound", "parameters", {"parameters": ["a"]}, sentence="At.")
    other = finding("at-bound", "parameters", {"parameters": ["b"]}, sentence="At.")
    few = finding("too-few-values", "data", {"n_values": 1}, sentence="Few.")
    again = finding("too-few-values", "data", {"n_values": 2}, sentence="Few, too.")
    sign = finding("moves-against-load", "data", {"coordinate": "varus_deg"}, sentence="Wrong.")
    given = (rim, few, again, bound, other, sign)
    assert by_severity(given) == [sign, bound, other, few, again, rim]
    assert without_repeats(given) == (sign, bound, other, few, rim)
    assert invalidating(given) == "Wrong."
