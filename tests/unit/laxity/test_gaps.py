"""Numbers that stand for missing values are named where they are hardly measured ones."""

from pathlib import Path

import numpy as np
import pytest

from identknee.laxity.named_tables import TABLES
from identknee.laxity.protocol import LOADS
from identknee.laxity.table import COORDINATES, WORKS_ON, read_laxity

CODE = "gap-as-number"
ANGLES = (0.0, 30.0, 60.0, 90.0)
HEAD = ("trial", "flexion_deg", *LOADS, *COORDINATES)


def rows(decimals: int = 4) -> list[list[str | float]]:
    """Unloaded and under each moment and drawer either way, at four angles."""
    found: list[list[str | float]] = []
    generator = np.random.default_rng(7)
    for angle in ANGLES:
        tests = [(i, x) for i, size in ((0, 5.0), (1, 10.0), (2, 100.0)) for x in (-size, size)]
        for load, size in [(0, 0.0), *tests]:
            loads = [size if i == load else 0.0 for i in range(len(LOADS))]
            moved = generator.normal(0.0, 1.0, len(COORDINATES))
            moved[COORDINATES.index(WORKS_ON[load])] += 10.0 * np.sign(size)
            name = f"t{len(found)}"
            found.append([name, angle, *loads, *np.round(moved, decimals).tolist()])
    return found


def findings(
    folder: Path, table: list[list[str | float]], *comments: str
) -> list[tuple[float, int, tuple[str, ...]]]:
    """Number, count and trials of each finding."""
    path = folder / "laxity.csv"
    lines = [*comments, ",".join(HEAD), *(",".join(map(str, x)) for x in table)]
    path.write_text("\n".join(lines))
    found = [x for x in read_laxity(path).findings if x.code == CODE]
    return [(x.values["number"], x.values["n"], tuple(x.values["trials"])) for x in found]


def with_cells(cells: dict[tuple[int, str], float], decimals: int = 4) -> list[list[str | float]]:
    table = rows(decimals)
    for (i, column), value in cells.items():
        table[i][HEAD.index(column)] = value
    return table


def test_a_sound_table_has_none(tmp_path: Path) -> None:
    assert findings(tmp_path, rows()) == []
    for name in TABLES:
        assert CODE not in {x.code for x in read_laxity(name).findings}


@pytest.mark.parametrize("code", [-99.0, 99.0])
def test_a_code_far_from_its_column_is_named(tmp_path: Path, code: float) -> None:
    table = with_cells({(3, "varus_deg"): code, (5, "lateral_shift_mm"): code, (8, "varus_deg"): 4})
    assert findings(tmp_path, table) == [(code, 2, ("t3", "t5"))]
    # Beside values of its size it is one of them.
    beside = with_cells({(3, "anterior_drawer_mm"): code, (4, "anterior_drawer_mm"): 0.6 * code})
    assert findings(tmp_path, beside) == []


def test_zero_along_the_load_is_named_where_rounding_hardly_makes_it(tmp_path: Path) -> None:
    along = {(1, "internal_deg"): 0.0, (9, "internal_deg"): 0.0, (4, "varus_deg"): 0.0}
    assert findings(tmp_path, with_cells(along)) == [(0.0, 3, ("t1", "t4", "t9"))]
    # To whole numbers many a zero is rounded.
    assert findings(tmp_path, with_cells(along, decimals=0)) == []
    # A rig may hold a coordinate across the load, and an unloaded trial be the zero.
    across = {(i, "internal_deg"): 0.0 for i in range(28) if i % 7 in (3, 4, 5, 6)}
    neutral = {(7 * i, x): 0.0 for i in range(4) for x in COORDINATES}
    assert findings(tmp_path, with_cells(across | neutral)) == []


def test_a_loaded_row_of_zeros_is_named_unless_it_is_the_stated_zero(tmp_path: Path) -> None:
    table = with_cells({(5, x): 0.0 for x in COORDINATES}, decimals=1)
    assert findings(tmp_path, table) == [(0.0, 5, ("t5",))]
    assert findings(tmp_path, table, "# zero: t5") == []
    # A compressed knee may be the zero, and a column of zeros be held by the rig.
    for row in table:
        row[HEAD.index("lateral_shift_mm")] = 0.0
    assert findings(tmp_path, table) == [(0.0, 4, ("t5",))]
    table[5][HEAD.index("anterior_force_N")] = 0.0
    table[5][HEAD.index("distraction_force_N")] = -200.0
    assert findings(tmp_path, table) == []
