"""What each method says of each parameter and force, side by side."""

from collections.abc import Sequence

from identknee.report.presenter import presenter_of
from identknee.report.range import Range, Source
from identknee.verbs.answer import Answer


def ranges_of(answers: Sequence[Answer]) -> dict[str, list[Range]]:
    """By the name of a parameter or force, what each method says of it, the most telling first.

    If two answers are of one kind, the later counts.
    """
    found: dict[str, dict[Source, Range]] = {}
    for answer in answers:
        for name, own in presenter_of(answer).ranges(answer):
            found.setdefault(name, {})[own.source] = own
    order = list(Source)
    return {
        name: sorted(by_source.values(), key=lambda x: order.index(x.source))
        for name, by_source in found.items()
    }
