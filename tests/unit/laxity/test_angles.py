"""Angles that were cut off by a whole turn, counted from 180, in radians, or swept under a load."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from identknee.checks.left_out_trials import trials_asked
from identknee.laxity.spreadsheets import is_in_radians
from identknee.laxity.table import COORDINATES, Laxity, read_laxity
from identknee.laxity.table_file import (
    coordinate_turns,
    flexion_turns,
    is_from_straight,
    is_negative,
)
from identknee.runs.errors import InputError

EXACT = 1e-9  # deg and mm, of numbers written with ten digits
FLEXION = np.array([-4.0, 5.0, 30.0, 60.0, 90.0])
INTERNAL = np.array([-12.0, -1.0, 3.0, 15.0, -8.0])


def table(folder: Path, flexion: np.ndarray, internal: np.ndarray, head: str = "") -> Path:
    rows = [f"t{i},{x!r},{y!r}" for i, (x, y) in enumerate(zip(flexion, internal, strict=True))]
    rows = [x.replace("np.float64(", "").replace(")", "") for x in rows]
    path = folder / "table.csv"
    path.write_text("\n".join([*head.splitlines(), "trial,flexion_deg,internal_deg", *rows]))
    return path


def codes(laxity: Laxity) -> list[tuple[str, str]]:
    return [(x.code, x.where) for x in trials_asked(laxity).findings]


def same(read: Laxity) -> None:
    np.testing.assert_allclose(read.protocol.flexion_deg, FLEXION, atol=EXACT)
    np.testing.assert_allclose(read.coordinates[:, 4], INTERNAL, atol=EXACT)


@pytest.mark.parametrize(
    ("flexion", "internal", "found"),
    [
        (FLEXION, INTERNAL, []),
        (FLEXION % 360, INTERNAL, ["flexion_deg"]),
        (FLEXION, INTERNAL % 360, ["internal_deg"]),
        (FLEXION % 360, INTERNAL % 360, ["flexion_deg", "internal_deg"]),
        (
            FLEXION - 360 * (FLEXION > 80),
            INTERNAL - 360 * (INTERNAL > 10),
            ["flexion_deg", "internal_deg"],
        ),
        (FLEXION - 360, INTERNAL + 360, ["flexion_deg", "internal_deg"]),
    ],
)
def test_a_turn_that_was_cut_off_is_given_back_and_said(
    flexion: np.ndarray, internal: np.ndarray, found: list[str], tmp_path: Path
) -> None:
    read = read_laxity(table(tmp_path, flexion, internal))
    same(read)
    assert codes(read) == [("angle-turned", x) for x in found]


def test_changes_about_half_a_turn_have_no_jump(tmp_path: Path) -> None:
    raw = (INTERNAL + 178.0 + 180.0) % 360.0 - 180.0
    assert np.ptp(raw) > 300.0
    read = read_laxity(table(tmp_path, FLEXION, raw))
    np.testing.assert_allclose(
        read.coordinates[:, 4] - read.coordinates[0, 4], INTERNAL - INTERNAL[0], atol=EXACT
    )
    assert codes(read) == [("angle-turned", "internal_deg")]


@pytest.mark.parametrize(
    "values",
    [[200.0, 12.0], [720.0], [-170.0, 20.0], [145.0, -36.0], [100.0, -100.0], [], [np.nan]],
)
def test_what_a_turn_does_not_explain_is_left(values: list[float]) -> None:
    assert not coordinate_turns(np.array(values)).any()


def test_flexion_that_no_turn_makes_a_flexion_is_left() -> None:
    assert not flexion_turns(np.array([200.0, -150.0, 600.0])).any()


@pytest.mark.parametrize(
    "counted",
    [
        lambda x: 180.0 - x,
        lambda x: (180.0 - x + 180.0) % 360.0 - 180.0,
        lambda x: (180.0 - x)[::-1],
        lambda x: (180.0 - x)[:2],
    ],
)
def test_flexion_from_a_straight_knee_is_named_with_the_line_that_reads_it(
    counted: Callable[[np.ndarray], np.ndarray], tmp_path: Path
) -> None:
    given = counted(FLEXION)
    zeros = np.zeros(len(given))
    assert is_from_straight(given)
    with pytest.raises(InputError) as caught:
        read_laxity(table(tmp_path, given, zeros))
    line = "# column: flexion_deg = 180 - flexion_deg"
    assert line in caught.value.remedy
    read = read_laxity(table(tmp_path, given, zeros, head=line))
    turned = 180.0 - given
    expected = turned - 360.0 * (turned > 180.0)
    np.testing.assert_allclose(read.protocol.flexion_deg, expected, atol=EXACT)


@pytest.mark.parametrize("some", [slice(None), slice(1, 3), slice(None, None, -1)])
def test_flexion_towards_negative_angles_is_named_with_the_line_that_reads_it(
    some: slice, tmp_path: Path
) -> None:
    given = -FLEXION[some]
    zeros = np.zeros(len(given))
    assert is_negative(given)
    with pytest.raises(InputError) as caught:
        read_laxity(table(tmp_path, given, zeros))
    line = "# column: flexion_deg = -1 * flexion_deg"
    assert line in caught.value.remedy
    read = read_laxity(table(tmp_path, given, zeros, head=line))
    np.testing.assert_allclose(read.protocol.flexion_deg, -given, atol=EXACT)


@pytest.mark.parametrize("flexion", [[-30.0, 60.0], [-8.0, -2.0], [-30.0, -200.0], [-9.0, 90.0]])
def test_one_negative_flexion_is_no_other_sign(flexion: list[float]) -> None:
    assert not is_negative(np.array(flexion))


@pytest.mark.parametrize(
    "flexion", [[170.0, 5.0, 30.0], [0.0, 90.0, 165.0], [90.0, 120.0, 135.0], [250.0, 170.0]]
)
def test_one_wrong_flexion_is_not_another_way_to_count(flexion: list[float]) -> None:
    assert not is_from_straight(np.array(flexion))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("180 - raw", 177.0),
        ("180 + raw", 183.0),
        ("5 - 2 * raw", -1.0),
        ("0.5 + -2 * raw", -5.5),
        ("- raw", -3.0),
        ("-2 * raw", -6.0),
        ("raw", 3.0),
        ("1 * raw", 3.0),
    ],
)
def test_a_column_may_count_from_elsewhere(line: str, expected: float, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(f"# column: anterior_drawer_mm = {line}\ntrial,flexion_deg,raw\na,0,3\n")
    assert read_laxity(path).coordinates[0, 1] == expected


HEAD = (
    "# column: flexion_deg = {} * knee\n# column: internal_deg = {} * rot\n"
    "# column: internal_moment_Nm = Mz\nendheader\ntime\tknee\trot\tMz\n"
)
KNEE, ROTATION = 0.5, (0.0, -0.1, -0.2)


def storage(path: Path, stated: str, *, factor: str = "1", deg: bool = False) -> Path:
    unit = 180.0 / np.pi if deg else 1.0
    rows = [f"{i}\t{KNEE * unit!r}\t{x * unit!r}\t{4.0 * i}" for i, x in enumerate(ROTATION)]
    text = "\n".join(rows).replace("np.float64(", "").replace(")", "")
    path.write_text(f"rig\n{stated}\n{HEAD.format(factor, factor)}{text}\n")
    return path


@pytest.mark.parametrize(
    ("suffix", "stated", "deg", "found"),
    [
        ("sto", "version=1", False, ["angles-in-radians"]),
        ("sto", "nRows=3", False, ["angles-in-radians"]),
        ("mot", "version=1", False, ["angles-in-radians"]),
        ("sto", "version=1\ninDegrees=no", False, []),
        ("sto", "version=1\ninDegrees no", False, []),
        ("sto", "version=1\ninDegrees=0", False, []),
        ("sto", "version=1\ninDegrees=yes", True, []),
        ("sto", "version=1\ninDegrees\tY", True, []),
        ("mot", "nRows=3", True, []),
        ("mot", "inDegrees=yes", True, []),
        ("sto", "Angles are in degrees.", True, []),
        ("sto", "Angles are in radians.", False, []),
    ],
)
def test_angles_of_a_storage_are_those_that_opensim_reads(
    suffix: str, stated: str, found: list[str], tmp_path: Path, *, deg: bool
) -> None:
    read = read_laxity(storage(tmp_path / f"ramp.{suffix}", stated, deg=deg))
    np.testing.assert_allclose(read.protocol.flexion_deg, np.degrees(KNEE))
    np.testing.assert_allclose(read.coordinates[:, 4], np.degrees(ROTATION[1:]))
    assert [x for x, _ in codes(read)] == found


def test_a_factor_that_makes_degrees_is_not_applied_twice(tmp_path: Path) -> None:
    read = read_laxity(storage(tmp_path / "ramp.sto", "version=1", factor="57.29577951308232"))
    np.testing.assert_allclose(read.coordinates[:, 4], np.degrees(ROTATION[1:]))
    assert codes(read) == []


def test_degrees_that_no_line_states_are_not_taken_for_radians(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="inDegrees=yes"):
        read_laxity(storage(tmp_path / "ramp.sto", "version=1", deg=True))


@pytest.mark.parametrize("line", ["inDegrees=no", "inDegrees=true", "Angles are in radians."])
def test_degrees_that_a_line_makes_radians_are_refused_by_that_line(
    line: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=f" {line} .*OpenSim"):
        read_laxity(storage(tmp_path / "ramp.sto", line, deg=True))


def test_radians_that_a_line_calls_degrees_are_named(tmp_path: Path) -> None:
    path = storage(tmp_path / "ramp.sto", "inDegrees=yes")
    path.write_text(path.read_text().replace("0.5\t", "0.4363323\t"))
    with pytest.raises(InputError, match=r"0\.436332") as caught:
        read_laxity(path)
    assert "radians" in caught.value.why
    assert "inDegrees=no" in caught.value.remedy


def test_a_sweep_of_flexion_in_radians_is_told_the_line(tmp_path: Path) -> None:
    rows = "\n".join(f"{i},{0.1 * i},5,{i}" for i in range(12))
    path = tmp_path / "sweep.csv"
    path.write_text(f"time_s,flexion_deg,varus_moment_Nm,internal_deg\n{rows}\n")
    with pytest.raises(InputError, match=r"57\.29578 \* ITS_NAME"):
        read_laxity(path)


@pytest.mark.parametrize("name", ["time", "time_ms", "t", "Time [s]"])
def test_a_time_of_another_name_is_told_the_line(name: str, tmp_path: Path) -> None:
    path = tmp_path / "series.csv"
    path.write_text(f"{name},flexion_deg,varus_moment_Nm,varus_deg\n0,0,5,1\n")
    with pytest.raises(InputError, match=r"# column: time_s = 1 \* "):
        read_laxity(path)


def test_a_head_that_does_not_end_is_named(tmp_path: Path) -> None:
    path = storage(tmp_path / "ramp.sto", "version=1")
    path.write_text(path.read_text().replace("endheader\n", ""))
    with pytest.raises(InputError, match="endheader"):
        read_laxity(path)


def test_a_storage_without_a_line_for_flexion_is_told_one(tmp_path: Path) -> None:
    path = storage(tmp_path / "ramp.sto", "version=1")
    path.write_text(re.sub("# column: flexion.*\n", "", path.read_text()))
    with pytest.raises(InputError, match=r"# column: flexion_deg = 1 \* ITS_NAME"):
        read_laxity(path)


@pytest.mark.parametrize(
    ("flexion", "is_so"),
    [
        ([0.0, 0.5236, 1.0472, np.nan], True),
        ([0.43633, 0.43633], True),
        ([0.0, 0.5, 1.0], False),
        ([0.0, 0.52, 0.0], False),
        ([0.09, 0.5236, 30.0], False),
        ([0.0, np.nan], False),
    ],
)
def test_small_flexion_is_no_radians(flexion: list[float], *, is_so: bool) -> None:
    assert is_in_radians(np.array(flexion)) == is_so


def test_a_line_that_opensim_ignores_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="version=1"):
        read_laxity(storage(tmp_path / "ramp.mot", "inDegrees=no"))


SLOPE = np.array([0.1, -0.05, 0.02, 0.03, -0.2])


def swept(
    path: Path,
    *,
    way: str = "up",
    load: float = 100.0,
    loop: float = 0.0,
    head: str = "",
    low: float = 2.0,
    high: float = 93.0,
    noise: float = 0.0,
) -> Path:
    """A series whose coordinates rise with flexion, off by `loop` on the way back."""
    up = np.linspace(low, high, 61)
    flexion = {"up": up, "down": up[::-1], "loops": np.tile(np.r_[up, up[::-1]], 2)}[way]
    back = np.r_[False, np.diff(flexion) < 0.0]
    generator = np.random.default_rng(0)
    force = load + noise * generator.standard_normal(len(flexion))
    rows = [
        ",".join(f"{x:.10g}" for x in (0.1 * i, a, f, *(SLOPE * a + loop * b)))
        for i, (a, f, b) in enumerate(zip(flexion, force, back, strict=True))
    ]
    names = ",".join(("time_s", "flexion_deg", "anterior_force_N", *COORDINATES))
    # These coordinates hang on the definition of translations by more than their noise of 0.
    head = f"# translations: components\n{head}"
    path.write_text("\n".join([*head.splitlines(), names, *rows]))
    return path


@pytest.mark.parametrize(
    ("more", "angles"),
    [
        ({}, (15, 30, 45, 60, 75, 90)),
        ({"way": "down"}, (15, 30, 45, 60, 75, 90)),
        ({"way": "loops"}, (15, 30, 45, 60, 75, 90)),
        ({"load": 0.0}, (15, 30, 45, 60, 75, 90)),
        ({"noise": 3.0}, (15, 30, 45, 60, 75, 90)),
        ({"head": "# angles: 5, 70.5, 120"}, (5, 70.5)),
        ({"low": 16.0, "high": 24.0}, (20,)),
    ],
)
def test_a_load_held_while_flexing_is_read_by_angle(
    more: dict[str, object], angles: tuple[float, ...], tmp_path: Path
) -> None:
    read = read_laxity(swept(tmp_path / "sweep.csv", **more))  # type: ignore[arg-type]
    np.testing.assert_allclose(read.protocol.flexion_deg, angles)
    assert read.protocol.trials == tuple(f"sweep_flexion{x:.3g}" for x in angles)
    np.testing.assert_allclose(read.coordinates, np.outer(angles, SLOPE), atol=1e-6)
    # Three standard deviations of the noise of a held load, the largest of six.
    off = 3.0 * float(more.get("noise", 0.0)) + 1e-6  # type: ignore[arg-type]
    np.testing.assert_allclose(read.protocol.loads[:, 2], float(more.get("load", 100.0)), atol=off)  # type: ignore[arg-type]
    assert codes(read) == [("flexed-under-load", "sweep")]


def test_what_differs_between_flexing_and_extending_is_an_error(tmp_path: Path) -> None:
    read = read_laxity(swept(tmp_path / "sweep.csv", way="loops", loop=2.0))
    np.testing.assert_allclose(
        read.coordinates[:, 4], -0.2 * read.protocol.flexion_deg + 1.0, atol=0.1
    )
    assert read.sd is not None
    np.testing.assert_allclose(read.sd, np.sqrt(4.0 / 3.0), rtol=0.1)


@pytest.mark.parametrize("stated", ["# angles: 0, 400", "# angles: thirty", "# angles:"])
def test_angles_that_are_none_are_refused(stated: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"# angles: 0, 30, 60, 90"):
        read_laxity(swept(tmp_path / "sweep.csv", head=stated))


def test_angles_that_no_ramp_reaches_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r" 2 to 93 deg"):
        read_laxity(swept(tmp_path / "sweep.csv", head="# angles: 120"))


def test_a_load_that_changes_while_flexing_is_refused(tmp_path: Path) -> None:
    path = swept(tmp_path / "sweep.csv", noise=60.0)
    with pytest.raises(InputError, match=r" 91\.0 deg ") as caught:
        read_laxity(path)
    assert "load changes" in caught.value.why


def test_jumps_of_a_turn_in_a_series_are_given_back(tmp_path: Path) -> None:
    path = swept(tmp_path / "sweep.csv", low=-8.0)
    expected = read_laxity(path)
    lines = path.read_text().splitlines()
    cells = [x.split(",") for x in lines[2:]]
    for row in cells:
        row[1], row[7] = (f"{float(x) % 360:.10g}" for x in (row[1], row[7]))
    path.write_text("\n".join([*lines[:2], *map(",".join, cells)]))
    read = read_laxity(path)
    np.testing.assert_allclose(read.coordinates, expected.coordinates, atol=1e-6)
    assert [x for x, _ in codes(read)] == ["angle-turned"] * 2 + ["flexed-under-load"]


@pytest.mark.parametrize(
    ("first", "separator"),
    [
        ("sep=;", ";"),
        ("sep=,", ","),
        ('"sep=;"', ";"),
        ("sep=;;;;", ";"),
        ("SEP=;", ";"),
        ("sep=\t", "\t"),
        ("sep=|", "|"),
        ("sep = ;", ";"),
        ("sep=;\r", ";"),
    ],
)
def test_the_first_line_of_a_spreadsheet_says_what_stands_between_cells(
    first: str, separator: str, tmp_path: Path
) -> None:
    header = separator.join(("trial", "flexion_deg", "internal_deg"))
    path = tmp_path / "table.csv"
    path.write_text(f"{first}\n{header}\n{separator.join(('a', '30', '1.5'))}\n")
    read = read_laxity(path)
    assert read.coordinates[0, 4] == 1.5
    if separator != ",":
        path.write_text(f"{first}\n{header}\n{separator.join(('a', '30', '1,5'))}\n")
        assert read_laxity(path).coordinates[0, 4] == 1.5


@pytest.mark.parametrize("first", ["sep=;", "sep=:", "sep=\t", "sep=*"])
def test_a_first_line_that_the_table_does_not_follow_is_refused_as_such(
    first: str, tmp_path: Path
) -> None:
    path = tmp_path / "table.csv"
    path.write_text(f"{first}\ntrial,flexion_deg,internal_deg\na,30,1.5\n")
    with pytest.raises(InputError) as caught:
        read_laxity(path)
    assert caught.value.where in ("row 1", "row 2")
    assert repr(first[4:]) in caught.value.why
