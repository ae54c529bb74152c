from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identknee.laxity.protocol import LOADS, Protocol
from identknee.laxity.table import COORDINATES, Laxity, read_laxity, write_laxity
from identknee.runs.errors import InputError

HEADER = "trial,flexion_deg,varus_moment_Nm,varus_deg,internal_deg\n"


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "laxity.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def laxity(n: int = 2, /, **changes: object) -> Laxity:
    protocol = Protocol(
        name="mine",
        trials=tuple(f"t{i}" for i in range(n)),
        flexion_deg=np.full(n, 30.0),
        loads=np.zeros((n, 5)),
    )
    whole = Laxity(protocol=protocol, coordinates=np.arange(5.0 * n).reshape(n, 5))
    return replace(whole, **changes)  # type: ignore[arg-type]


def assert_equal(one: Laxity, other: Laxity) -> None:
    assert one.protocol.trials == other.protocol.trials
    for name in ("flexion_deg", "loads"):
        assert getattr(one.protocol, name).tobytes() == getattr(other.protocol, name).tobytes()
    np.testing.assert_array_equal(one.coordinates, other.coordinates)
    for name in ("sd", "order"):
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_array_equal(a, b)
    for name in ("phase", "comments", "zero", "within_trial_correlation"):
        assert getattr(one, name) == getattr(other, name), name


def test_opposite_coordinates_are_read_with_their_sign(tmp_path: Path) -> None:
    read = read_laxity(written(tmp_path, "trial,flexion_deg,valgus_deg,external_deg\na,30,1,-2\n"))
    angles = dict(zip(COORDINATES, read.coordinates[0].tolist(), strict=True))
    assert (angles["varus_deg"], angles["internal_deg"]) == (-1.0, 2.0)


def test_read_what_a_person_writes(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        "\ufeff# robot 3, knee 12\r\n"
        "#within_trial_correlation : 0.3,,,\r\n"
        "\r\n"
        'trial , flexion_deg,"varus_moment_Nm", varus_deg,'
        "sd_varus_deg,internal_deg,order,phase,\r\n"
        '"a, first" , 30, -5 , -2.5e0,.3,,1,Loading,\r\n'
        "# a pause\r\n"
        'b,30,5,"2.25",0.3,-1,2,,\r\n'
        ",,,,,,,,\r\n",
    )
    read = read_laxity(path)
    assert read.protocol.name == "laxity"
    assert read.protocol.trials == ("a, first", "b")
    assert read.protocol.flexion_deg.tolist() == [30, 30]
    assert read.protocol.loads[:, LOADS.index("varus_moment_Nm")].tolist() == [-5, 5]
    assert not np.delete(read.protocol.loads, LOADS.index("varus_moment_Nm"), axis=1).any()
    nan = np.nan
    np.testing.assert_array_equal(
        read.coordinates, [[nan, nan, nan, -2.5, nan], [nan, nan, nan, 2.25, -1]]
    )
    assert read.sd is not None
    np.testing.assert_array_equal(read.sd, [[nan, nan, nan, 0.3, nan]] * 2)
    assert read.order is not None
    assert read.order.tolist() == [1, 2]
    assert read.phase == ("loading", "")
    assert read.comments == ("robot 3, knee 12", "a pause")
    assert read.within_trial_correlation == 0.3
    assert read.zero == "absolute"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_row_numbers_are_line_numbers_for_any_line_end(tmp_path: Path, end: str) -> None:
    lines = ["# one", "", HEADER.strip(), "a,30,5,1,1", "# two", "b,30,5,x,1"]
    with pytest.raises(InputError) as caught:
        read_laxity(written(tmp_path, end.join(lines)))
    assert caught.value.where == "row 6, column varus_deg"


def test_equal_loads_are_replicates_and_zero_can_be_unloaded(tmp_path: Path) -> None:
    read = read_laxity(
        written(tmp_path, "# zero: unloaded\n" + HEADER + "a,30,5,1,1\nb,30,5,2,1\n")
    )
    assert read.n == 2
    assert read.zero == "unloaded"


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            "a,30,5,NaN,1",
            (
                ", row 2, column varus_deg: 'NaN' is not a number. Write a number, or leave the "
                "cell blank where nothing was measured."
            ),
        ),
        (
            "a,30,5,-inf,1",
            (
                ", row 2, column varus_deg: '-inf' is not a number. Write a number, or leave the "
                "cell blank where nothing was measured."
            ),
        ),
        (
            "a,30,5,500,1",
            (
                ", row 2, column varus_deg: an angle of 500 deg is beyond 180 deg either way. "
                "Give angles in degrees, 0 where the axes of both bones agree."
            ),
        ),
        (
            "a,30,5,-999,1",
            (
                ", row 2, column varus_deg: an angle of -999 deg is beyond 180 deg either way. "
                "If it stands for a missing value, leave the cell blank."
            ),
        ),
        (
            "a,30,5,1e999,1",
            (
                ", row 2, column varus_deg: 1e999 is too large to be a number here. "
                "Check its exponent."
            ),
        ),
        (
            'a,30,5,"1,5",1',
            ", row 2, column varus_deg: '1,5' is not a number. Write it with a decimal point.",
        ),
        (
            "a,30,\u22125,1,1",
            (
                ", row 2, column varus_moment_Nm: '\u22125' is not a number. "
                "Write the minus sign as a plain hyphen."
            ),
        ),
        (
            "a,30,5 Nm,1,1",
            (
                ", row 2, column varus_moment_Nm: '5 Nm' is not a number. Write the number alone: "
                "the unit is in the column's name."
            ),
        ),
        (
            "a,,5,1,1",
            (
                ", row 2, column flexion_deg: the cell is blank. Write a number in every row, also "
                "where cells were merged: 0 if it is zero."
            ),
        ),
        (
            "a,30,,1,1",
            (
                ", row 2, column varus_moment_Nm: the cell is blank. Write a number in every row, "
                "also where cells were merged: 0 if it is zero."
            ),
        ),
        (
            ",30,5,1,1",
            ", row 2, column trial: the trial has no name. Give every trial a name of its own.",
        ),
        (
            "a,30,5,1,1\nb,30,5,1,1\na,60,5,1,1",
            (
                ", row 4, column trial: 'a' already names the trial of row 2. "
                "Give each trial its own name; replicates of one load are welcome."
            ),
        ),
        (
            "a,30,10000,1,1",
            (
                ", row 2, column varus_moment_Nm: a moment of 10000 N·m is beyond 50 N·m either "
                "way. Divide it by 1000 if it is in N·mm, by 100 if in N·cm, by 8.85 if in "
                "inch-pounds."
            ),
        ),
        (
            "a,300,5,1,1",
            (
                ", row 2, column flexion_deg: a flexion of 300 deg lies outside -10 to 160 deg. "
                "Give the flexion angle in degrees, 0 in extension."
            ),
        ),
        (
            "a,30,5,1",
            (
                ", row 2: there are 4 cells under 5 columns. Give each column one cell, blank "
                "where there is nothing to say, and put cells that hold a comma in quotes. Where "
                "numbers have decimal commas, put semicolons between cells."
            ),
        ),
        (
            "a,30,5,1,1,7",
            (
                ", row 2: there are 6 cells under 5 columns. Give each column one cell, blank "
                "where there is nothing to say, and put cells that hold a comma in quotes. Where "
                "numbers have decimal commas, put semicolons between cells."
            ),
        ),
        ('"a,30,5,1,1', ', row 2: a quote is left open. Close it, or write "" for a quote mark.'),
        ("", ": there is no trial below the header. Add one row per trial."),
        (
            "# zero: neutral\na,30,5,1,1",
            (
                ", row 2: the zero 'neutral' is unknown and not the name of a trial. "
                "Write unloaded, opposite or the name of a trial, or leave the line out."
            ),
        ),
        (
            "# within_trial_correlation: 1\na,30,5,1,1",
            ", row 2: the within-trial correlation is 1. It must lie above -0.25 and below 1.",
        ),
        (
            "# zero: absolute\n# zero: unloaded\na,30,5,1,1",
            ", row 3: zero is stated in row 2 too. Remove one.",
        ),
    ],
)
def test_messages_about_rows(tmp_path: Path, rows: str, message: str) -> None:
    path = written(tmp_path, HEADER + rows)
    with pytest.raises(InputError) as caught:
        read_laxity(path)
    assert str(caught.value) == f"{path}{message}"


def test_no_translation_of_a_knee_is_longer_than_a_hand(tmp_path: Path) -> None:
    header = "trial,flexion_deg,lateral_shift_mm\n"
    assert read_laxity(written(tmp_path, header + "a,30,-200")).coordinates[0, 0] == -200.0
    with pytest.raises(InputError, match=r"row.2.*lateral_shift_mm.*-201"):
        read_laxity(written(tmp_path, header + "a,30,-201"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "trial,flexion_deg,varus\na,30,1",
            ", row 1, column varus: this column is unknown. Did you mean varus_deg?",
        ),
        (
            "# x\ntrial,flexion_deg,Internal_Moment_Nm,varus_deg\na,30,1,1",
            (
                ", row 2, column Internal_Moment_Nm: this column is unknown. "
                "Did you mean internal_moment_Nm?"
            ),
        ),
        (
            "trial,flexion_deg,internal_rad\na,30,0.2",
            (
                ", row 1, column internal_rad: this column is unknown. "
                "Did you mean internal_deg? If so, convert its values to that unit."
            ),
        ),
        (
            "trial,flexion_deg,valgus_moment,varus_deg\na,30,1,1",
            (
                ", row 1, column valgus_moment: this column is unknown. "
                "Did you mean valgus_moment_Nm?"
            ),
        ),
        (
            "trial,flexion_deg,varus_deg,dMCL_force_kN\na,30,1,0.1",
            (
                ", row 1, column dMCL_force_kN: this column is unknown. A ligament's tension is "
                "read from the columns dMCL_tension_N and sd_dMCL_tension_N. For the first, begin "
                "the file: # column: dMCL_tension_N = 1000 * dMCL_force_kN"
            ),
        ),
        (
            "trial,flexion_deg,ANTERIOR_FORCE_N,varus_deg\na,30,1,1",
            (
                ", row 1, column ANTERIOR_FORCE_N: this column is unknown. "
                "Did you mean anterior_force_N?"
            ),
        ),
        (
            "trial,varus_deg\na,1",
            ", row 1, column flexion_deg: this column is missing. Add it; every row needs it.",
        ),
        (
            "trial,flexion_deg,varus_deg,varus_deg\na,30,1,1",
            ", row 1, column varus_deg: two columns have this name. Remove one.",
        ),
        (
            "trial,flexion_deg,,varus_deg\na,30,1,1",
            ", row 1: a column has no name. Name it or remove it.",
        ),
        (
            "trial;flexion_deg;varus_deg\na;30;1.234,5",
            (
                ", row 2, column varus_deg: '1.234,5' is not a number. Write it without a sign for "
                "thousands."
            ),
        ),
        (
            "trial,flexion_deg,varus_moment_Nm,valgus_moment_Nm,varus_deg\na,30,1,-1,2",
            (
                ", row 1, column valgus_moment_Nm: varus_moment_Nm is there too, of which it is "
                "the negative. Remove one of the two."
            ),
        ),
        (
            "trial,flexion_deg,valgus_moment_Nm,varus_deg\na,30,x,2",
            ", row 2, column valgus_moment_Nm: 'x' is not a number. Write a number, such as 2.5.",
        ),
        (
            "trial,flexion_deg\na,30",
            (
                ", row 1: no column holds a coordinate. Add one or more of lateral_shift_mm, "
                "anterior_drawer_mm, distraction_mm, varus_deg, internal_deg."
            ),
        ),
        (
            "trial,flexion_deg,varus_deg,sd_internal_deg\na,30,1,1",
            (
                ", row 1, column sd_internal_deg: there is no column internal_deg for this "
                "standard deviation. Add it or remove this one."
            ),
        ),
        (
            "trial,flexion_deg,varus_deg,sd_varus_deg\na,30,1,-0.3",
            (
                ", row 2, column sd_varus_deg: the standard deviation is -0.3. "
                "It must be greater than 0; remove the column if it is unknown."
            ),
        ),
        (
            "trial,flexion_deg,varus_deg,sd_varus_deg\na,30,1,0",
            (
                ", row 2, column sd_varus_deg: the standard deviation is 0. "
                "It must be greater than 0; remove the column if it is unknown."
            ),
        ),
        (
            "trial,flexion_deg,varus_deg,sd_varus_deg\na,30,1,",
            (
                ", row 2, column sd_varus_deg: varus_deg is measured but its standard deviation is "
                "blank. Give it in every such row, or remove the column."
            ),
        ),
        (
            "trial,flexion_deg,varus_deg,order\na,30,1,1.5",
            ", row 2, column order: 1.5 is not a whole number. Count the trials 1, 2, 3 and so on.",
        ),
        (
            "trial,flexion_deg,varus_deg,phase\na,30,1,up",
            (
                ", row 2, column phase: the phase 'up' is unknown. "
                "Write loading or unloading, or leave it blank."
            ),
        ),
        ("# only\n\n", ": there is no header. Start with a row of column names."),
        (b"trial,flexion_deg\n\xff", ": the text is not UTF-8. Save the table as CSV in UTF-8."),
        ("", ": the file is empty. Write or export it again."),
    ],
)
def test_messages_about_columns_and_files(tmp_path: Path, text: str | bytes, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_laxity(path)
    assert str(caught.value) == f"{path}{message}"


def test_a_column_of_another_name_may_be_told_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "laxity.csv"
    path.write_text("trial,flexion_deg,knob,varus_deg\na,30,1,2", encoding="utf-8")
    with pytest.raises(InputError, match=r"# column: ONE = 1 \* knob$"):
        read_laxity(path)


def test_a_file_over_512_megabytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "laxity.csv"
    with path.open("wb") as file:
        file.truncate(600 * 10**6)
    with pytest.raises(InputError, match=r"600 MB.*512 MB"):
        read_laxity(path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv.*such"):
        read_laxity(tmp_path / "none.csv")


# Within what a knee may do, whether a column is in mm or deg.
# Angles all beyond 150 deg, on both sides, are read as one course about half a turn.
finite = st.floats(-149.0, 149.0)
names = st.text(
    st.characters(codec="utf-8", exclude_categories=["C", "Z"], include_characters=' ,"#'),
    min_size=1,
).filter(lambda name: name == name.strip() and name.isprintable())


@st.composite
def laxities(draw: st.DrawFn) -> Laxity:
    trials = draw(st.lists(names, min_size=1, max_size=4, unique=True))
    n = len(trials)
    coordinates = [
        draw(st.lists(st.one_of(finite, st.just(np.nan)), min_size=5, max_size=5)) for _ in trials
    ]
    sd = np.array(draw(st.lists(st.floats(1e-300, 1e300), min_size=5 * n, max_size=5 * n))).reshape(
        n, 5
    )
    sd[:, draw(st.lists(st.booleans(), min_size=5, max_size=5))] = np.nan
    return Laxity(
        protocol=Protocol(
            name="laxity",
            trials=tuple(trials),
            flexion_deg=np.array(draw(st.lists(st.floats(-10, 160), min_size=n, max_size=n))),
            loads=np.array(
                draw(st.lists(st.floats(-50, 50), min_size=5 * n, max_size=5 * n))
            ).reshape(n, 5),
        ),
        coordinates=np.array(coordinates),
        sd=draw(st.sampled_from([None, sd])),
        within_trial_correlation=draw(st.floats(-0.2499, 0.9999)),
        order=draw(st.sampled_from([None, np.arange(n)])),
        phase=draw(st.sampled_from([None, ("loading", "", "unloading", "loading")[:n]])),
        comments=tuple(draw(st.lists(names, max_size=2))),
        zero=draw(st.sampled_from(["absolute", "unloaded"])),
    )


@settings(max_examples=150, deadline=None)
@given(original=laxities())
def test_writing_and_reading_gives_the_same_bits(
    original: Laxity, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("round") / "laxity.csv"
    again = read_laxity(write_laxity(original, path))
    assert_equal(again, original)
    assert again.protocol.name == "laxity"
    text = path.read_bytes()
    write_laxity(again, path)
    assert path.read_bytes() == text


def test_what_is_written_is_short(tmp_path: Path) -> None:
    whole = laxity(1, coordinates=[[0.1, np.nan, 1 / 3, -2.0, 0.0]], comments=("hello",))
    assert write_laxity(whole, tmp_path / "a.csv").read_text() == (
        "# hello\n"
        "trial,flexion_deg,internal_moment_Nm,varus_moment_Nm,anterior_force_N,"
        "distraction_force_N,lateral_force_N,lateral_shift_mm,anterior_drawer_mm,distraction_mm,"
        "varus_deg,internal_deg\n"
        "t0,30.0,0.0,0.0,0.0,0.0,0.0,0.1,,0.3333333333333333,-2.0,0.0\n"
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"coordinates": np.zeros((3, 5))}, "coordinates must have shape 2 x 5"),
        ({"coordinates": np.full((2, 5), np.inf)}, "must be finite"),
        ({"sd": np.zeros((2, 5))}, "must be greater than 0"),
        ({"sd": [[1, 1, 1, 1, 1], [1, 1, np.nan, 1, 1]]}, "distraction_mm has .* all or none"),
        ({"within_trial_correlation": 1.0}, "above -0.25 and below 1"),
        ({"order": [1.5, 2]}, "whole numbers"),
        ({"phase": ("loading", "up")}, "phase must hold 2 of"),
        ({"comments": ("zero: unloaded",)}, "states no setting"),
        ({"comments": ("a\nb",)}, "a comment is one line"),
        ({"zero": "neutral"}, "the zero 'neutral' is unknown and not the name of a trial"),
    ],
)
def test_laxity_checks_its_values(changes: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        laxity(**changes)


def test_select_takes_every_field_along() -> None:
    whole = laxity(3, sd=np.ones((3, 5)), order=[3, 1, 2], phase=("loading", "", "unloading"))
    part = whole.select([2, 0])
    assert part.protocol.trials == ("t2", "t0")
    assert part.coordinates[:, 0].tolist() == [10, 0]
    assert part.order is not None
    assert part.order.tolist() == [2, 3]
    assert part.phase == ("unloading", "loading")
    assert whole.select(whole.coordinates[:, 0] > 1).n == 2


def test_laxity_is_read_only_and_knows_what_was_measured() -> None:
    whole = laxity(1, coordinates=[[0, np.nan, 0, 0, 0]])
    assert whole.is_measured.tolist() == [[True, False, True, True, True]]
    with pytest.raises(ValueError, match="read-only"):
        whole.coordinates[0, 0] = 1
    assert len(COORDINATES) == 5


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_table_with_decimal_commas_reads_as_one_with_points(
    separator: str, tmp_path: Path
) -> None:
    file = tmp_path / "table.csv"
    lines = ["# zero: unloaded;;;", "trial;flexion_deg;valgus_moment_Nm;varus_deg"]
    lines += ["a;30,5;10;-1,25", "b;30,5;0;0,5", "c;30.5;0;"]
    file.write_text("\n".join(lines).replace(";", separator), encoding="utf-8")
    laxity = read_laxity(file)
    assert laxity.zero == "unloaded"
    assert laxity.protocol.flexion_deg.tolist() == [30.5] * 3
    varus_moment = laxity.protocol.loads[:, 1]
    assert varus_moment.tolist() == [-10.0, 0.0, 0.0]
    assert not np.signbit(varus_moment[1:]).any()
    np.testing.assert_array_equal(laxity.coordinates[:, 3], [-1.25, 0.5, np.nan])
