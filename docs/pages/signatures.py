"""Signatures with the short names of array types, as the code has them."""

import re

WHOLE = r"~?numpy\.ndarray\[~?tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?numpy\.dtype\[~?numpy\.{}\]\]"
NAMES = {
    WHOLE.format(kind): name
    for kind, name in (("float64", "Array"), ("int64", "IntArray"), ("bool_?", "BoolArray"))
}
# Everything that numpy takes for an array, as a union of what that may be.
ARRAY_LIKE = re.compile(
    r"~?[\w.]*_?Buffer \| ~?[\w.]*_SupportsArray\[.*?_NestedSequence\[complex \| bytes \| str\]"
)


def shortened(
    _app: object, _kind: str, _name: str, _value: object, _how: object, call: str, back: str
) -> tuple[str | None, str | None]:
    """Arguments and what comes back, as autodoc's event wants them."""
    return _short(call), _short(back)


def _short(text: str | None) -> str | None:
    if text is None:
        return None
    for pattern, name in NAMES.items():
        text = re.sub(pattern, name, text)
    return ARRAY_LIKE.sub("ArrayLike", text)
