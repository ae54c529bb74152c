"""Tables as spreadsheets, data frames and R save them: read, or refused for what is odd."""

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest

from identknee.laxity.table import Laxity, read_laxity
from identknee.runs.errors import InputError

HEAD = [
    "trial",
    "flexion_deg",
    "varus_moment_Nm",
    "anterior_force_N",
    "distraction_mm",
    "varus_deg",
]
ROWS = [["a", "0.5", "-10.25", "0.5", "1.25", "-3.5"], ["b", "30.5", "2.5", "1.5", "0.75", "1.447"]]
UNITS = ["", "deg", "Nm", "N", "mm", "deg"]


def text(*, head: list[str] | None = None, rows: list[list[str]] | None = None) -> str:
    lines = [head or HEAD, *(ROWS if rows is None else rows)]
    return "".join(",".join(x) + "\n" for x in lines)


def semicolons(table: str) -> str:
    return table.replace(",", ";").replace(".", ",")


def read(path: Path, content: str | bytes) -> Laxity:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_laxity(path)


def cell(value: str) -> str:
    return text(rows=[[*ROWS[0][:-1], value], ROWS[1]])


@pytest.fixture
def plain(tmp_path: Path) -> Laxity:
    return read(tmp_path / "plain.csv", text())


@pytest.mark.parametrize(
    "content",
    [
        ("\ufeff" + semicolons(text()).replace("\n", "\r\n")).encode("utf-16-le"),
        semicolons(text()).encode("utf-16"),
        ("\ufeffsep=;\n" + semicolons(text())).encode("utf-16-be"),
        ("\ufeff" + text().replace(",", "\t")).encode("utf-16-le"),
        text(rows=[UNITS, *ROWS]),
        text(rows=[["units", *(f"[{x}]" for x in UNITS[1:])], *ROWS]),
        text(rows=[["-", "°", "N·m", "(N)", "mm", "degrees"], *ROWS]),
        text(rows=[["-", "deg", "n.m", "n", "mm", "deg"], *ROWS]),
        text(head=["", *HEAD], rows=[[str(i), *x] for i, x in enumerate(ROWS)]),
        text(head=['""', *HEAD], rows=[[f'"{3 * i + 1}"', *x] for i, x in enumerate(ROWS)]),
        text(head=["Unnamed: 0", *HEAD], rows=[[str(i), *x] for i, x in enumerate(ROWS)]),
    ],
)
def test_it_is_read_as_the_plain_table(tmp_path: Path, plain: Laxity, content: str | bytes) -> None:
    found = read(tmp_path / "a.csv", content)
    assert found.protocol.trials == plain.protocol.trials
    np.testing.assert_array_equal(found.coordinates, plain.coordinates)
    np.testing.assert_array_equal(found.protocol.loads, plain.protocol.loads)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (text(rows=[["", "rad", "Nm", "N", "mm", "deg"], *ROWS]), "flexion_deg: .* says rad"),
        (text(rows=[["", "deg", "Nm", "N", "m", "deg"], *ROWS]), "distraction_mm: .* says m"),
        (text(rows=[["", "deg", "N", "N", "mm", "deg"], *ROWS]), "varus_moment_Nm: .* says N"),
        *(
            (text(rows=[["", "deg", x, "n", "mm", "deg"], *ROWS]), f"varus_moment_Nm: .* says {y}")
            for x, y in (
                ("N·mm", "N·mm"),
                ("n.mm", "n.mm"),
                ("[nmm]", "nmm"),
                ("(n * mm)", r"n \* mm"),
                ("kgf·m", "kgf·m"),
                ("in-lb", "in-lb"),
            )
        ),
        ("Specimen 4,,,,,\n\nleft,,,,,\n" + text(), r"row 1: the column names stand in row 4"),
        (",,loads,,laxity,\n" + text(), r"row 1: the column names stand in row 2"),
        ("x,x,x,y,y,y\n" + text(), r"the column names stand in row 2\. Begin every line above"),
        (text().replace(",", "  "), "separated by spaces"),
        (b"PK\x03\x04\x14\x00\x06\x00", "this is a workbook"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "this is a workbook"),
        (gzip.compress(text().encode()), r"a\.csv: this is a packed file.*\. Unpack it"),
        (bz2.compress(text().encode()), "this is a packed file"),
        (b"\xff\xfea\x00\x00\xd8", "not the UTF-16"),
        (cell('"1,447.0"'), "row 2, column varus_deg: .* without a sign for thousands"),
        (cell("1 447.0"), "without a sign for thousands"),
        (cell("1'447.0"), "without a sign for thousands"),
        (cell("01.Feb"), "may have made a date of it"),
        (cell("2024-02-01"), "may have made a date of it"),
        (cell("Feb 24"), "may have made a date of it"),
        (cell("45323"), "may have made a date of it"),
        (cell("1.4 deg"), "the unit is in the column's name"),
        (text().replace("a,0.5", "a,0,5"), "7 cells under 6 columns.* put semicolons between"),
        (text(head=["", *HEAD[1:]]), "missing. If the first column has the names of trials, call"),
        (text(head=["", *HEAD], rows=[["u", *ROWS[0]]]), "row 1: a column has no name"),
        (text(head=[*HEAD, "", "varus_deg"], rows=[]), "a column has no name"),
    ],
)
def test_what_is_odd_is_named(tmp_path: Path, content: str | bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(tmp_path / "a.csv", content)


def test_a_sign_for_thousands_among_decimal_commas_is_no_decimal_sign(tmp_path: Path) -> None:
    """1.000 N beside 0,75 mm would be read as 1 N."""
    german = semicolons(text())
    assert read(tmp_path / "a.csv", german).protocol.loads[1, 2] == 1.5
    for number in ("1,5;", "-10,25;0,5;"):
        changed = german.replace(number, number.replace(number[-4:], "1.000;"))
        assert changed != german
        with pytest.raises(InputError, match=r"1\.000 .*decimal sign"):
            read(tmp_path / "b.csv", changed)


def test_one_decimal_sign_may_stand_beside_whole_numbers(tmp_path: Path) -> None:
    found = read(tmp_path / "a.csv", semicolons(text()).replace("30,5", "30"))
    assert found.protocol.flexion_deg.tolist() == [0.5, 30.0]
