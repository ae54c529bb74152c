"""The measured laxity that comes with identknee."""

from pathlib import Path

import numpy as np
import pytest

from identknee.laxity.named_tables import FOLDER, TABLES, laxity_file
from identknee.laxity.table import COORDINATES, Laxity, example_laxity, read_laxity, write_laxity
from identknee.runs.errors import InputError
from identknee.runs.files import digest

# As the page beside the table prints it: opposite loads summed, by nominal flexion angle.
SUMS = {
    ("Anterior", "Posterior", "anterior_drawer_mm"): [10.5, 8.3, 8.7, 9.4],
    ("Internal", "External", "internal_deg"): [32.1, 39.6, 39.7, 43.3],
    ("Varus", "Valgus", "varus_deg"): [7.0, 9.3, 1.8, 12.5],
}
PRINTED = 0.051
# Of the table as it was converted from the deposit, in which nothing is mended.
DIGEST = "4bf5ed32d3ba652362e5a50b52922e0bdee0472dfa365db5b94548b7b6b405af"


def moved(laxity: Laxity, trial: str, coordinate: str) -> float:
    row = laxity.protocol.trials.index(trial)
    return float(laxity.coordinates[row, COORDINATES.index(coordinate)])


def test_the_table_of_the_specimen_is_read_whole() -> None:
    laxity = example_laxity("s192803")
    assert laxity.n == 25
    assert laxity.protocol.name == "s192803"
    assert laxity.is_measured.all()
    assert laxity.sd is None
    assert laxity.zero == "absolute"
    assert any("doi:10.5061/dryad.zkh1893gw" in line for line in laxity.comments)
    # Every trial has its own angle and some of each load.
    assert len(set(laxity.protocol.flexion_deg)) == 25
    assert (laxity.protocol.loads != 0).all()


def test_no_number_of_the_table_was_touched() -> None:
    assert digest(TABLES["s192803"]) == DIGEST


@pytest.mark.parametrize(("names", "sums"), SUMS.items())
def test_opposite_loads_sum_to_what_is_printed(
    names: tuple[str, str, str], sums: list[float]
) -> None:
    laxity = example_laxity("s192803")
    one, other, coordinate = names
    found = [
        moved(laxity, f"{one}_{angle}", coordinate) - moved(laxity, f"{other}_{angle}", coordinate)
        for angle in (0, 30, 60, 90)
    ]
    assert found == pytest.approx(sums, abs=PRINTED)


def test_a_name_stands_for_the_table() -> None:
    for name in TABLES:
        np.testing.assert_array_equal(
            read_laxity(name).coordinates, example_laxity("s192803").coordinates
        )


def test_a_path_stands_for_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_laxity(example_laxity("s192803").select([0, 1]), tmp_path / "s192803")
    monkeypatch.chdir(tmp_path)
    assert read_laxity("s192803").n == 25
    for path in ("./s192803", Path("s192803")):
        assert read_laxity(path).n == 2


def test_a_mistyped_name_is_answered_with_the_names() -> None:
    with pytest.raises(InputError, match="no laxity of this name") as caught:
        read_laxity("s192830")
    assert caught.value.remedy == "Did you mean s192803? Or give the path of a table."
    with pytest.raises(ValueError, match=r"no laxity of 'reference' comes with identknee\. Known"):
        example_laxity("reference")
    # What reads like a file is missed like a file.
    assert laxity_file("s192830.csv") == Path("s192830.csv")


def test_the_tables_say_where_they_come_from() -> None:
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    for file in FOLDER.glob("*.csv"):
        assert file.name in page
