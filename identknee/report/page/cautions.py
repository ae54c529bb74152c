"""What results say against themselves, each thing once, the gravest first."""

import re
from collections.abc import Iterable

from identknee.runs.findings import Severity

# Results of the same data say the same with slightly other numbers. The numbers in names stay.
_NUMBER = re.compile(r"(?<!\w)[\u2212-]?\d[\d.]*(?:e[\u2212-]?\d+)?(?!\w)")
# The beginning that several sentences may share.
_BEGINNING = re.compile(r"(?:Warning|Error): The fit is not believable here: ")
ERROR = Severity.ERROR.prefix


def told_once(sentences: Iterable[tuple[str, str]]) -> list[str]:
    """Warnings without duplicates of other results, errors first.

    Parameters
    ----------
    sentences
        Each with the result that says it. Of sentences that two results say, but for their
        numbers, the first one stays; of one that goes on where another ends, the longer one.
        Sentences with one beginning become one.

    Examples
    --------
    >>> told_once([("Warning: A carries 3 N.", "fit"), ("Warning: A carries 4 N.", "profile")])
    ['Warning: A carries 3 N.']
    """
    kept: list[tuple[str, str, str]] = []
    for sentence, source in sentences:
        key = _NUMBER.sub("#", sentence)
        same = [i for i, x in enumerate(kept) if _one_goes_on(x[0], key) and x[2] != source]
        if not same:
            kept.append((key, sentence, source))
        elif len(key) > len(kept[same[0]][0]):
            kept[same[0]] = (key, sentence, source)
    merged = _with_one_beginning(x[1] for x in kept)
    return sorted(merged, key=lambda x: not x.startswith(ERROR))


def _one_goes_on(first: str, second: str) -> bool:
    return first.startswith(second) or second.startswith(first)


def _with_one_beginning(sentences: Iterable[str]) -> list[str]:
    """Sentences that begin alike as one, what follows the beginning one after the other."""
    parts: dict[str, list[str]] = {}
    for sentence in sentences:
        found = _BEGINNING.match(sentence)
        beginning = found[0] if found else sentence
        parts.setdefault(beginning, []).append(sentence.removeprefix(beginning))
    return [
        beginning + ("; ".join(x.rstrip(".") for x in ends) + "." if len(ends) > 1 else ends[0])
        for beginning, ends in parts.items()
    ]
