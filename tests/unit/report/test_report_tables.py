import numpy as np
import pytest
from common.page import filled
from common.published import TABLE2, TABLE5
from common.rows_of_paper import error_table, laxity_table, start_table
from common.spreads import median_range, spread

from identknee.report.presenter import Column, Table

SMALL = Table(
    title="Two springs",
    columns=(
        Column(name="spring"),
        Column(name="k", unit="kN", decimals=1),
        Column(name="error", decimals=None),
        Column(name="n"),
    ),
    rows=(("left", 1.25, 1.23456e-7, 3), ("right", -0.01, None, 0)),
)


def test_markdown_has_units_in_its_heads_and_numbers_to_the_right() -> None:
    assert SMALL.markdown().splitlines() == [
        "**Two springs**",
        "",
        "| spring | k [kN] | error | n |",
        "| --- | ---: | ---: | ---: |",
        "| left | 1.2 | 1.235e-07 | 3 |",
        "| right | 0.0 | - | 0 |",
    ]


def test_text_is_in_columns() -> None:
    assert str(SMALL).splitlines() == [
        "Two springs",
        "spring  k [kN]      error  n",
        "left       1.2  1.235e-07  3",
        "right      0.0          -  0",
    ]


def test_remarks_that_nobody_made_are_not_shown() -> None:
    columns = tuple(Column(name=x) for x in ("parameter", "remark"))
    blank = Table(title="t", columns=columns, rows=(("a", ""), ("b", "")))
    assert [x.name for x in blank.without_blank_columns.columns] == ["parameter"]
    assert "remark" not in str(blank)
    said = Table(title="t", columns=columns, rows=(("a", ""), ("b", "at its bound")))
    assert said.without_blank_columns is said
    assert "remark" in str(said)


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="1 cells, got 2"):
        Table(title="t", columns=(Column(name="a"),), rows=((1, 2),))


def test_filling_replaces_what_stood_in_the_place_and_nothing_else() -> None:
    page = "before\n<!-- a -->\nold\n<!-- end a -->\nafter"
    once = filled(page, {"a": SMALL})
    assert once == f"before\n<!-- a -->\n{SMALL.markdown()}\n<!-- end a -->\nafter"
    assert filled(once, {"a": SMALL}) == once


def test_a_page_without_the_place_is_refused() -> None:
    with pytest.raises(ValueError, match="<!-- b -->"):
        filled("nothing", {"b": SMALL})


def test_laxity_table_counts_standard_deviations() -> None:
    mine = np.array([row.mean + 2.0 * row.sd for row in TABLE2])
    mine[1] = np.nan
    table = laxity_table(TABLE2, {"mine": mine})
    assert len(table.rows) == 13
    assert table.rows[0][:6] == ("anterior force", "134 N", 30, "mm", "5.6 (3.1)", 5.7)
    assert table.rows[0][-1] == pytest.approx(2.0)
    assert table.rows[1][-2:] == (None, None)


def test_start_table_has_the_distances_of_the_paper() -> None:
    reference = [10.0, 18.0, 6.0, 8.3, 8.0, -4.0, 2.0, 4.0]
    starts = {"IG1": reference, "IG4": [8.0, 8.0, 8.0, 8.0, 4.0, 4.0, 4.0, 4.0]}
    table = start_table(["ACL", "PCL", "LCL", "MCL"], starts, reference)
    assert table.columns[1].head == "ACL stiffness [kN]"
    assert table.rows[0][-2:] == (0.0, 0.0)
    assert table.rows[1][1:5] == (8.0, 4.0, 8.0, 4.0)
    assert table.rows[1][-2:] == pytest.approx((3.575, 3.5))


def test_error_table_keeps_the_published_rows_and_adds_ours() -> None:
    table = error_table(TABLE5, {"ours": np.array([0.1, 0.2, 0.34])})
    assert len(table.rows) == len(TABLE5) + 1
    assert table.rows[0] == ("Baldwin (internal, varus)", "2.6 (0.3)", "0.6 (0.4)", None)
    assert table.rows[-1] == ("ours", "0.10", "0.20", "0.34")


def test_median_and_range_as_text() -> None:
    assert median_range(spread([3.0, 1.0, 2.0]), 1) == "2.0 [1.0, 3.0]"
    assert median_range(spread([]), 1) == "-"
