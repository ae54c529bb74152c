"""How easy English is to read, by the formula of Flesch (1948).

A score of 100 is a children's book, 60 a newspaper, 30 a law. Code, tables, links' addresses and
names of options are no prose and are left out.

References
----------
R. Flesch, A new readability yardstick, J. Appl. Psychol. 32 (1948) 221-233.
"""

import re

_CODE = re.compile(r"```.*?```|^(?: {4}|\||#)[^\n]*$|<!--.*?-->", re.DOTALL | re.MULTILINE)
_NAMES = re.compile(r"!\[[^\]]*\]\([^)]*\)|`[^`]*`|https?://\S+|--[\w-]+|\b\w+[_.]\w[\w.]*\b")
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_END = re.compile(r"[.!?](?:\s|$)|\n\s*\n|\n\s*(?:[-*]|\d\.)\s")
_WORD = re.compile(r"[A-Za-z][A-Za-z']*")


def prose(markdown: str) -> str:
    """The sentences of a page, without code, tables, headings and names."""
    return _NAMES.sub(" ", _LINK.sub(r"\1", _CODE.sub("\n\n", markdown)))


def reading_ease(text: str) -> float:
    """Flesch's reading ease of plain English.

    >>> reading_ease("The cat sat on the mat.") > 100
    True
    >>> reading_ease("Institutional heterogeneity necessitates organisational reconfiguration.") < 0
    True
    """
    sentences = [x for x in _END.split(text) if len(_WORD.findall(x)) > 1]
    words = [x for sentence in sentences for x in _WORD.findall(sentence)]
    syllables = sum(map(n_syllables, words))
    return 206.835 - 1.015 * len(words) / len(sentences) - 84.6 * syllables / len(words)


def n_syllables(word: str) -> int:
    """Syllables of an English word, by its groups of vowels.

    >>> [n_syllables(x) for x in ("knee", "ligament", "stable", "moved", "loaded", "trial", "the")]
    [1, 3, 2, 1, 2, 2, 1]
    """
    letters = re.sub(r"[^a-z]", "", word.lower())
    count = len(re.findall(r"[aeiouy]+", letters)) + len(re.findall(r"i[aou](?!u)", letters))
    count -= len(re.findall(r"(?:ti|ci|si|gi)(?:on|ous|al|an)", letters))
    if re.search(r"[^l]e$|[^td]ed$|[^aeiouycgszx]es$", letters) and count > 1:
        count -= 1
    return max(count, 1)
