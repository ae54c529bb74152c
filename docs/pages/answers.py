"""The page on answers, which follows from their declarations."""

from collections.abc import Iterator

from identknee.blind_test.blind_data import Revelation
from identknee.runs.declare import Entry, derived_entries, entries
from identknee.runs.schema import record_within, type_hints_of
from identknee.verbs.installation import Installation
from identknee.verbs.registry import verbs
from identknee.verbs.subject import NamedSubjects

# What is printed and leaves no files.
PRINTED = {"reveal": Revelation, "doctor": Installation, "subject list": NamedSubjects}
HEAD = "| name | unit | axes | file | is |\n| --- | --- | --- | --- | --- |"


def answer_reference_page() -> str:
    """A table for the answer of each verb, then one for each kind of record, as Markdown."""
    parts: list[str] = []
    records: dict[type, None] = {}
    for verb, answer in ({x.name: x.answer_class for x in verbs()} | PRINTED).items():
        parts += [f"## {verb}", _summary(answer), _table(answer)]
        records |= dict.fromkeys(_records(answer))
    parts.append("## Records")
    for kind in records:
        parts += [f"### {kind.__name__}", _summary(kind), _table(kind)]
    return "\n\n".join(parts) + "\n"


def _summary(cls: type) -> str:
    return (cls.__doc__ or "").partition("\n")[0]


def _records(cls: type) -> Iterator[type]:
    """The declared classes within a class, and within those."""
    for hint in type_hints_of(cls).values():
        kind, _ = record_within(hint)
        if kind is not None:
            yield kind
            yield from _records(kind)


def _table(cls: type) -> str:
    return "\n".join([HEAD, *_lines(cls)])


def _lines(cls: type) -> Iterator[str]:
    hints = type_hints_of(cls)
    for name, about in (entries(cls) | derived_entries(cls)).items():
        kind, how = record_within(hints.get(name))
        if kind is not None and about.is_inline:
            yield from _lines(kind)
            continue
        many = {"dict": "by name, each a", "list": "in a list, each a", "one": "a"}
        meaning = about.meaning if kind is None else f"{about.meaning}: {many[how]} {kind.__name__}"
        unit = about.unit or ("" if not about.dims else "1")
        axes = ", ".join(about.dims) or about.rows
        yield f"| `{about.key or name}` | {unit} | {axes} | {_file(about)} | {meaning} |"


def _file(about: Entry) -> str:
    """Which of the two files has it, and in which group."""
    group = f", group `{about.group}`" if about.group else ""
    if not about.is_in_json:
        return f"nc{group}" if about.is_in_files else "none"
    return f"json and nc{group}" if about.is_in_arrays or about.rows else "json"
