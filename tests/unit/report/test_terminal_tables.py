"""Long tables on a terminal: the first rows, and how many more there are."""

from identknee.report.presenter import Column, Table


def test_a_terminal_shows_the_first_rows_and_counts_the_others() -> None:
    rows = tuple((f"error {k}", float(k)) for k in range(5))
    table = Table(
        title="Errors", columns=(Column(name="error"), Column(name="size")), rows=rows, most=2
    )
    lines = str(table).splitlines()
    assert [x.split()[:2] for x in lines[2:4]] == [["error", "0"], ["error", "1"]]
    assert [x.split()[:4] for x in lines[4:]] == [["and", "3", "more", "rows,"]]
    # The page shows them all.
    assert table.markdown().count("error ") == 1 + len(rows)
    whole = Table(title="Errors", columns=table.columns, rows=rows, most=5)
    assert len(str(whole).splitlines()) == 2 + len(rows)
