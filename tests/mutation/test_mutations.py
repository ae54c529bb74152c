"""The list of faults fits the code as it is, and its record says that every one was seen."""

import json
from collections import Counter

import pytest
from mutation import ROOT, Mutation, fault
from mutations import MUTATIONS
from run_mutations import VERDICT

FEWEST = 74


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda x: x.why)
def test_every_fault_has_its_place_and_its_tests(mutation: Mutation) -> None:
    text = (ROOT / mutation.file).read_text(encoding="utf-8")
    assert mutation.applied(text) != text
    assert mutation.tests
    for test in mutation.tests:
        file, _, name = test.partition("::")
        source = (ROOT / file).read_text(encoding="utf-8")
        assert not name or f"def {name}(" in source


def test_faults_are_many_and_different() -> None:
    assert len(MUTATIONS) >= FEWEST
    assert Counter(x.name for x in MUTATIONS).most_common(1)[0][1] == 1


def test_the_record_has_seen_all_of_them() -> None:
    """Run ``python tests/mutation/run_mutations.py`` where this fails."""
    record = json.loads(VERDICT.read_text(encoding="utf-8"))
    assert record["caught"] == record["count"] == len(record["mutations"])
    assert {x["name"] for x in record["mutations"]} == {x.name for x in MUTATIONS}
    assert all(x["caught"] for x in record["mutations"])


def test_a_fault_needs_one_place() -> None:
    place = fault("x.py", "f", "a + 1", "a - 1", "")
    assert place.applied("def f(a):\n    return a  +  1") == "def f(a):\n    return (a - 1)"
    for text in ("def f(a):\n    return a", "def f(a):\n    return (a + 1) * (a + 1)", "b = a + 1"):
        with pytest.raises(ValueError, match="one place"):
            place.applied(text)


def test_statements_are_found_by_their_tree() -> None:
    place = fault("x.py", "", "a = 1\nb = 2", "a = 2", "")
    assert place.applied("if c:\n    a = 1  # why\n    b = 2\n") == "if c:\n    a = 2\n"
