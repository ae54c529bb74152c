"""What is done to a whole file or call: strategies from its content to something like it."""

import copy
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from typing import Any
from xml.etree import ElementTree as ET

from hypothesis import strategies as st

Strategy = st.SearchStrategy[bytes]
# In any text: numbers that overflow or are none, names and separators where none belong, nesting.
LITERALS: Sequence[str] = (
    *("", " ", "0", "-0", "-1", "1", "3", "1e-320", "1e17", "1e200", "1e308", "-1e308", "1e999"),
    *("nan", "inf", "-inf", "NaN", "Infinity", "null", "true", "None", "0x" + "f" * 400),
    *("9" * 30, "9" * 400, "9" * 5000, "'", '"', '""', "'x'", '"x"', "[]", "{}", "[[]]", "[1, 2]"),
    *("[" * 300, "[" * 5000, "{" * 300, "<a>" * 300, "a" + ".a" * 2000, "x" * 3000, "\t", "\r"),
    *("\n", "\n\n", "\0", "\u00e9", "\u202e", "\U0001f9b4", "$x^$", "<b>", "&amp;", "&", "%", "#"),
    *(
        ",",
        ";",
        "=",
        "==",
        "[x]",
        "[[ligaments]]",
        "2000-02-31",
        "1979-05-27T07:32:00Z",
        "reference",
    ),
    *("../../etc", "/dev/null", "a/b", "ACL", "format", "12:00:00.000000001", "\\u0000", "\\ud800"),
)
VALUES: Sequence[Any] = (
    *(None, True, False, 0, -1, 3, 1.5, -2.5, 10**30, 10**400, 1e-320, 1e17, 1e200, 1e308, -1e308),
    *(
        float("nan"),
        float("inf"),
        "",
        "x",
        "nan",
        "a\nb",
        "a\0b",
        "\u202e",
        "\ud800",
        "$x^$",
        "<b>",
    ),
    *(
        "x" * 3000,
        [],
        {},
        [[]],
        [1.0, 2.0],
        [None, None],
        [None],
        {"a": 1},
        {"": {}},
        [[1.0], [2.0]],
    ),
    *(json.loads("[" * 60 + "]" * 60), json.loads("[" * 400 + "]" * 400)),
)
# What a careless hand or a spreadsheet writes.
PLAIN: Sequence[str] = (
    *(
        "",
        "0",
        "-0.0",
        "-1",
        "1",
        "2",
        "7",
        "30",
        "100",
        "999",
        "1e3",
        "-1e3",
        "1e6",
        "1e-9",
        "1e17",
    ),
    *("1e200", "1e308", "-1e308", "1e999", "1e-320", "nan", "NaN", "inf", "-inf", "1.5.2", "1 5"),
    *("9" * 30, "9" * 400, "x", "a b", "ACL", "true", "None", "12:30", "0x1f", "1_000", "\u0661"),
    *("reference", "internal_deg", "trial", "unloaded", "a" * 3000, "$x^$", "-", "+", ".", "e5"),
)
_STATEMENTS = ("within_trial_correlation", "zero", "x")
_NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")
_TOKEN = re.compile(r"[-+.\w]+|\"[^\"]*\"|'[^']*'")


@st.composite
def texts(draw: st.DrawFn, corpus: Sequence[bytes]) -> bytes:
    """A text with one to three pieces changed."""
    text = draw(st.sampled_from(corpus)).decode("utf-8")
    for _ in range(draw(st.integers(1, 3))):
        text = draw(st.sampled_from(_TEXT_CHANGES))(draw, text)
    content = text.encode("utf-8", "surrogatepass")
    return draw(binaries([content])) if draw(st.integers(0, 9)) == 0 else content


@st.composite
def binaries(draw: st.DrawFn, corpus: Sequence[bytes]) -> bytes:
    """Bytes with one to three places changed."""
    content = draw(st.sampled_from(corpus))
    for _ in range(draw(st.integers(1, 3))):
        content = draw(st.sampled_from(_BYTE_CHANGES))(draw, content)
    return content


@st.composite
def trees(draw: st.DrawFn, corpus: Sequence[bytes]) -> bytes:
    """JSON in which one to three values, keys or elements are others."""
    tree = json.loads(draw(st.sampled_from(corpus)))
    for _ in range(draw(st.integers(1, 3))):
        places = list(_places(tree))
        if places:
            _change(draw, tree, draw(st.sampled_from(places)))
    return json.dumps(tree).encode()


@st.composite
def tomls(draw: st.DrawFn, corpus: Sequence[bytes]) -> bytes:
    """TOML in which one to three values, keys or elements are others; it stays TOML."""
    whole = json.dumps(tomllib.loads(draw(st.sampled_from(corpus)).decode("utf-8")))
    tree = json.loads(draw(trees([whole.encode()])))
    return _toml(tree).encode("utf-8", "surrogatepass")


def _toml(tree: Any) -> str:
    lines = [f"{_key(key)} = {_inline(value)}" for key, value in tree.items() if value is not None]
    return "\n".join([*lines, ""])


def _key(key: str) -> str:
    return json.dumps(key, ensure_ascii=False) if not re.fullmatch(r"[\w-]+", key) else key


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        inner = (f"{_key(k)} = {_inline(x)}" for k, x in value.items() if x is not None)
        return "{ " + ", ".join(inner) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(x) for x in value if x is not None) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value)


@st.composite
def tables(draw: st.DrawFn, corpus: Sequence[bytes]) -> bytes:
    """CSV in which one to three cells, rows or columns are others."""
    lines = draw(st.sampled_from(corpus)).decode("utf-8").splitlines()
    notes = [x for x in lines if x.startswith("#")]
    rows = [x.split(",") for x in lines if not x.startswith("#")]
    for _ in range(draw(st.integers(1, 3))):
        kind, row = draw(st.integers(0, 7)), draw(st.integers(0, len(rows) - 1))
        column = draw(st.integers(0, len(rows[0]) - 1))
        if kind == 0:
            rows.append(list(rows[row]))
        elif kind == 1:
            for other in rows:
                del other[column : column + 1]
        elif kind == 2:
            notes.append(f"# {draw(st.sampled_from(_STATEMENTS))}: {draw(st.sampled_from(PLAIN))}")
        elif column < len(rows[row]):
            rows[row][column] = draw(st.sampled_from(PLAIN))
    return "\n".join([*notes, *(",".join(x) for x in rows), ""]).encode()


@st.composite
def elements(draw: st.DrawFn, corpus: Sequence[bytes]) -> bytes:
    """XML in which one to three elements are others; it stays XML."""
    root = ET.fromstring(draw(st.sampled_from(corpus)))
    for _ in range(draw(st.integers(1, 3))):
        every = [(x, y) for x in root.iter() for y in x]
        if not every:
            break
        owner, one = every[draw(st.integers(0, len(every) - 1))]
        kind = draw(st.integers(0, 7))
        if kind == 0:
            owner.remove(one)
        elif kind == 1:
            owner.append(copy.deepcopy(one))
        elif kind == 2:
            one.append(copy.deepcopy(draw(st.sampled_from(every))[1]))
        elif kind == 3:
            one.set(draw(st.sampled_from(("name", "Version"))), draw(st.sampled_from(PLAIN)))
        elif kind == 4:
            one.tag = draw(st.sampled_from(every))[1].tag
        elif kind == 5:
            one.text = draw(st.sampled_from(every))[1].text
        else:
            words = (one.text or "").split() or [""]
            words[draw(st.integers(0, len(words) - 1))] = draw(st.sampled_from(PLAIN))
            one.text = " ".join(words)
    return ET.tostring(root)


@st.composite
def numbers(draw: st.DrawFn, corpus: Sequence[bytes]) -> bytes:
    """A text in which one to three numbers are others."""
    text = draw(st.sampled_from(corpus)).decode("utf-8")
    for _ in range(draw(st.integers(1, 3))):
        found = list(_NUMBER.finditer(text))
        if found:
            one = found[draw(st.integers(0, len(found) - 1))]
            text = text[: one.start()] + draw(st.sampled_from(PLAIN)) + text[one.end() :]
    return text.encode()


def _places(tree: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    children: Any = ()
    if isinstance(tree, dict):
        children = tree.items()
    elif isinstance(tree, list):
        # The rest of a long list is like its beginning.
        children = enumerate(tree[:8])
    if len(above) < 12:
        for key, value in children:
            yield (*above, key)
            yield from _places(value, (*above, key))


def _change(draw: st.DrawFn, tree: Any, place: tuple[Any, ...]) -> None:
    *way, last = place
    owner = tree
    for step in way:
        owner = owner[step]
    kind = draw(st.integers(0, 6))
    if kind == 0:
        del owner[last]
    elif kind == 1 and isinstance(owner, dict):
        owner[str(draw(st.sampled_from(LITERALS)))] = owner.pop(last)
    elif kind == 2 and isinstance(owner, list):
        owner.append(copy.deepcopy(owner[last]))
    elif kind == 3 and isinstance(owner, dict):
        other = draw(st.sampled_from(sorted(owner)))
        owner[last], owner[other] = owner[other], owner[last]
    elif kind == 4 and isinstance(owner[last], dict | list):
        owner[last] = type(owner[last])()
    else:
        owner[last] = copy.deepcopy(draw(st.sampled_from(VALUES)))


def _replace_token(draw: st.DrawFn, text: str) -> str:
    tokens = list(_TOKEN.finditer(text))
    if not tokens:
        return text
    found = tokens[draw(st.integers(0, len(tokens) - 1))]
    return text[: found.start()] + draw(st.sampled_from(LITERALS)) + text[found.end() :]


def _swap_tokens(draw: st.DrawFn, text: str) -> str:
    tokens = list(_TOKEN.finditer(text))
    if len(tokens) < 2:
        return text
    first, second = sorted(
        draw(st.lists(st.integers(0, len(tokens) - 1), min_size=2, max_size=2, unique=True))
    )
    a, b = tokens[first], tokens[second]
    return text[: a.start()] + b[0] + text[a.end() : b.start()] + a[0] + text[b.end() :]


def _insert(draw: st.DrawFn, text: str) -> str:
    at = draw(st.integers(0, len(text)))
    return text[:at] + draw(st.sampled_from(LITERALS)) + text[at:]


def _delete(draw: st.DrawFn, text: str) -> str:
    at = draw(st.integers(0, len(text)))
    return text[:at] + text[at + draw(st.integers(1, 40)) :]


def _lines(draw: st.DrawFn, text: str) -> str:
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    at = draw(st.integers(0, len(lines) - 1))
    kind = draw(st.integers(0, 3))
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(at, lines[at])
    elif kind == 2:
        other = draw(st.integers(0, len(lines) - 1))
        lines[at], lines[other] = lines[other], lines[at]
    else:
        lines = lines[:at]
    return "".join(lines)


def _flip(draw: st.DrawFn, content: bytes) -> bytes:
    if not content:
        return content
    at = draw(_position(content))
    return content[:at] + bytes([draw(st.integers(0, 255))]) + content[at + 1 :]


def _overwrite(draw: st.DrawFn, content: bytes) -> bytes:
    # As whole numbers, lengths and counts of any size; as numbers, infinities and NaN.
    block = draw(
        st.sampled_from((b"\xff" * 4, b"\0" * 4, b"\xff\xff\xff\x7f", b"\0\0\x80\x7f", b"\xff" * 8))
    )
    at = draw(_position(content))
    return content[:at] + block + content[at + len(block) :]


def _cut(draw: st.DrawFn, content: bytes) -> bytes:
    return content[: draw(_position(content))]


def _remove(draw: st.DrawFn, content: bytes) -> bytes:
    at = draw(_position(content))
    return content[:at] + content[at + draw(st.integers(1, 64)) :]


def _double(draw: st.DrawFn, content: bytes) -> bytes:
    at, n = draw(_position(content)), draw(st.integers(1, 64))
    return content[: at + n] + content[at : at + n] + content[at + n :]


def _position(content: bytes) -> st.SearchStrategy[int]:
    # The header, where a file says what it is, as often as all the rest.
    end = max(len(content) - 1, 0)
    return st.one_of(st.integers(0, min(200, end)), st.integers(0, end))


_TEXT_CHANGES: Sequence[Callable[[st.DrawFn, str], str]] = (
    *(_replace_token, _replace_token, _replace_token),
    *(_swap_tokens, _insert, _delete, _lines),
)
_BYTE_CHANGES: Sequence[Callable[[st.DrawFn, bytes], bytes]] = (
    *(_flip, _flip, _overwrite, _cut, _remove, _double),
)
