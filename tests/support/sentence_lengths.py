"""How long the sentences of a page are: a reader loses the thread of a very long one.

Code, tables, links' addresses and names of options are no prose and are left out.
"""

import re

MOST_WORDS = 30
_CODE = re.compile(
    r"```.*?```|\$\$.*?\$\$|^(?: {4}|\||#)[^\n]*$|<!--.*?-->", re.DOTALL | re.MULTILINE
)
_NAMES = re.compile(
    r"!\[[^\]]*\]\([^)]*\)|`[^`]*`|\$[^$]*\$|https?://\S+|--[\w-]+|\b\w+[_.]\w[\w.]*\b"
)
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_END = re.compile(r"[.!?](?:\s|$)|\n\s*\n|\n\s*(?:[-*]|\d\.)\s")
_WORD = re.compile(r"[^\W\d_]+")


def prose(markdown: str) -> str:
    """The sentences of a page, without code, tables, headings and names."""
    return _NAMES.sub(" ", _LINK.sub(r"\1", _CODE.sub("\n\n", markdown)))


def long_sentences(markdown: str) -> list[str]:
    """Sentences of more than `MOST_WORDS` words.

    >>> long_sentences("The knee is loose. Pull it, and see how far it goes.")
    []
    >>> len(long_sentences("word " * 31 + "."))
    1
    """
    sentences = (" ".join(x.split()) for x in _END.split(prose(markdown)))
    return [x for x in sentences if len(_WORD.findall(x)) > MOST_WORDS]
